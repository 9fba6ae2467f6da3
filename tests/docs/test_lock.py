"""constraints.lock: every package that CI installs, at the version of constraints.txt, with hashes."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parent.parent.parent
ORACLES = "\n# The extra `oracles`"
"""Beginning of the last part of constraints.txt, which constraints.lock leaves out."""


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
    text, divided, _ = (ROOT / "constraints.txt").read_text(encoding="utf-8").partition(ORACLES)
    assert divided
    lines = (line.partition("==") for line in text.splitlines())
    return {normal(name): version for name, _, version in lines if version}


def test_each_package_has_hashes() -> None:
    assert len(locked()) > 60
    assert not {name for name, (_, hashes) in locked().items() if not hashes}


def test_versions_are_those_that_were_tested() -> None:
    versions = pinned()
    others = {name: version for name, (version, _) in locked().items() if versions.get(name, version) != version}
    assert not others, "run .ci/lock"
    missing = {name for name in versions if name not in locked()}
    assert not missing, "run .ci/lock"


def test_nothing_that_make_test_installs_brings_torch() -> None:
    assert not {"torch", "torchvision", "triton", "gsplat"} & set(locked())


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@pytest.mark.parametrize("target", ["setup", "docs"])
def test_make_installs_only_locked_files(target: str) -> None:
    command = ["make", "--dry-run", "--always-make", "LOCKED=1", "VENV=nowhere", target]
    planned = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    installs = [line for line in planned.splitlines() if "pip install" in line]
    assert "--no-deps --require-hashes --requirement constraints.lock" in installs[0]
    assert {"editables", "hatchling"} <= set(locked()), "so that the second line installs nothing"
    assert all("--no-deps" in line for line in installs[2:])


def test_workflows_install_locked_files() -> None:
    for path in (ROOT / ".github" / "workflows").glob("*.yml"):
        assert yaml.safe_load(path.read_text(encoding="utf-8"))["env"]["LOCKED"] == 1
