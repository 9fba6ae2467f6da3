"""The player's TypeScript: unit tests under node, types, and the committed bundle against its source."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

PLAYER = Path(__file__).parents[2] / "player"
UNIT_TESTS = sorted(path.relative_to(PLAYER / "tests").as_posix() for path in (PLAYER / "tests").rglob("*.test.ts"))
STATIC = PLAYER.parent / "src" / "splatreel" / "play" / "static"

needs_node = pytest.mark.usefixtures("packages")


@pytest.fixture(scope="module")
def packages() -> None:
    """Install the player's packages. A clone without them is untested, so tests skip only if they cannot be installed."""
    if shutil.which("npm") is None:
        pytest.skip("needs node and npm")
    assert (PLAYER / "node_modules").is_dir(), "The player's packages are missing: make test, or npm ci in player/"


def run(*command: str) -> None:
    result = subprocess.run(command, cwd=PLAYER, capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.fixture(scope="module")
def unit_results(packages: None) -> dict[str, dict]:
    """Return the passed and failed tests by file of player/tests. TypeScript's coverage is measured along with Python's.

    The script fails if tests fail, which `test_units` reports, or if the coverage is too low, which is reported here.
    """
    results = PLAYER / "out" / "tests.json"
    results.unlink(missing_ok=True)
    command = ["node", *(["--experimental-test-coverage"] if "COVERAGE_RUN" in os.environ else []), "test.mjs"]
    result = subprocess.run(command, cwd=PLAYER, capture_output=True, text=True, timeout=900)
    assert results.exists(), result.stdout + result.stderr
    assert "must run at least" not in result.stderr, result.stderr
    return json.loads(results.read_text())["files"]


@needs_node
@pytest.mark.parametrize("name", UNIT_TESTS)
def test_units(unit_results: dict[str, dict], name: str):
    result = unit_results[name]
    assert not result["failed"], "\n\n".join(result["failed"])
    assert result["passed"] > 0


@needs_node
def test_types():
    run("node", "node_modules/typescript/bin/tsc", "--noEmit")


@needs_node
def test_the_committed_bundle_is_what_the_source_builds():
    run("node", "check.mjs")


def test_the_lock_file_names_no_host():
    resolved = re.findall(r'"resolved": "([^"]*)"', (PLAYER / "package-lock.json").read_text())
    assert all(name.startswith("packages/") for name in resolved), "npm of this machine wrote where it found packages"


def test_the_player_is_small():
    import gzip

    scripts = [STATIC / name for name in ("player.js", "decode-worker.js", "hevc-worker.js", "sort-worker.js")]
    assert sum(len(gzip.compress(path.read_bytes())) for path in scripts) < 83_000
