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


TYPED = """import { SplatReelElement, type Player } from "splatreel-player";
import { SplatReel } from "@splatreel/three";
import { SplatReel as Script } from "@splatreel/playcanvas";
import { openReel, type ReelReader } from "@splatreel/decoder";
type IsAny<T> = 0 extends 1 & T ? true : false;
type Typed = [SplatReelElement, Player, SplatReel, Script, Awaited<ReturnType<typeof openReel>>, ReelReader["info"]];
export const known: { [K in keyof Typed]: IsAny<Typed[K]> } = [false, false, false, false, false, false];
export const reel: SplatReelElement | null = document.querySelector("splat-reel");
export const times: number[] = [new SplatReel("a").currentTime, reel!.player.manifest!.fps];
"""


@needs_node
@pytest.mark.slow
def test_the_types_of_the_packages_are_known_to_each_resolution(tmp_path: Path):
    """TypeScript reads them as Node does (node16, nodenext) and as bundlers do, and checks the declarations, too."""
    modules = tmp_path / "node_modules"
    folders = {"splatreel-player": PLAYER} | {
        f"@splatreel/{name}": PLAYER / "packages" / name for name in ("decoder", "three", "playcanvas")
    }
    for name, folder in folders.items():
        (modules / name).mkdir(parents=True)
        shutil.copy(folder / "package.json", modules / name)
        run("node", "types.mjs", str(folder), str(modules / name / "dist"))
    for name in ("three", "playcanvas", "@types"):
        (modules / name).symlink_to(PLAYER / "node_modules" / name)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "page.ts").write_text(TYPED)
    strict = {"strict": True, "skipLibCheck": False, "preserveSymlinks": True, "noEmit": True, "target": "es2022"}
    for module, resolution in (("node16", "node16"), ("nodenext", "nodenext"), ("esnext", "bundler")):
        options = strict | {"types": ["webxr"], "module": module, "moduleResolution": resolution}
        (tmp_path / "tsconfig.json").write_text(json.dumps({"compilerOptions": options, "files": ["page.ts"]}))
        run("node", "node_modules/typescript/bin/tsc", "-p", str(tmp_path))


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
