"""constraints.lock: every package that CI installs, at the version of constraints.txt, with hashes."""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
LEFT_OUT = re.compile(r"torch|triton|cuda-|nvidia-")


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def locked() -> dict[str, tuple[str, int]]:
    """Return the version of each package, and how many hashes it has."""
    found: dict[str, tuple[str, int]] = {}
    text = (ROOT / "constraints.lock").read_text(encoding="utf-8").replace("\\\n", " ")
    for line in text.splitlines():
        if line and not line.startswith("#"):
            match = re.match(r"([\w.-]+)==([^\s;]+)", line)
            assert match is not None, line
            found[normal(match[1])] = match[2], len(re.findall(r"--hash=sha256:[0-9a-f]{64}", line))
    return found


def pinned() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    return {normal(name): version for name, _, version in (line.partition("==") for line in lines) if version}


def test_each_package_has_hashes() -> None:
    assert len(locked()) > 60
    assert not {name for name, (_, hashes) in locked().items() if not hashes}


def test_versions_are_those_that_were_tested() -> None:
    versions = pinned()
    others = {name: version for name, (version, _) in locked().items() if versions.get(name, version) != version}
    assert not others, "run .ci/lock"
    missing = {name for name in versions if name not in locked() and not LEFT_OUT.match(name)}
    assert not missing, "run .ci/lock"


def test_what_differs_from_machine_to_machine_is_left_out() -> None:
    assert not [name for name in locked() if LEFT_OUT.match(name)]
