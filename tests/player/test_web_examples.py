"""The web examples build, and play the golden reel."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from playwright.sync_api import Page

from splatreel.play.player_page import STATIC
from tests.golden import GOLDEN
from tests.player.hosts import host
from tests.player.pages import wait_for_picture

pytestmark = [pytest.mark.browser, pytest.mark.slow]

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"


def build(name: str, folder: Path) -> Path:
    """Build an example with the player of this checkout and the golden reel, and return the folder of the built page."""
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("the web examples need node and npm")
    app = folder / name
    shutil.copytree(EXAMPLES / name, app, ignore=shutil.ignore_patterns("node_modules", "dist", "public"))
    package = json.loads((app / "package.json").read_text(encoding="utf-8"))
    name = next(name for name in package["dependencies"] if "splatreel" in name)
    source = ROOT / "player" if name == "splatreel-player" else ROOT / "player" / "packages" / name.partition("/")[2]
    if name != "splatreel-player":
        subprocess.run(["node", source / "build.mjs"], cwd=ROOT / "player", check=True, timeout=600)
    shutil.copytree(STATIC if name == "splatreel-player" else source / "dist", app / "package" / "dist")
    shutil.copy(source / "package.json", app / "package")
    shutil.copytree(GOLDEN, app / "public" / "reel")
    package["dependencies"][name] = "file:package"
    (app / "package.json").write_text(json.dumps(package), encoding="utf-8")
    command = [npm, "install", "--no-audit", "--no-fund", "--ignore-scripts", "--install-links"]
    try:
        result = subprocess.run(command, cwd=app, capture_output=True, text=True, timeout=300)
    except subprocess.TimeoutExpired:
        pytest.skip("npm does not install the packages within five minutes: is there a package registry?")
    if result.returncode != 0:
        pytest.skip(f"npm cannot install the packages: {result.stderr.strip()[-300:]}")
    result = subprocess.run([npm, "run", "build"], cwd=app, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stdout + result.stderr
    return app / "dist"


def test_versions_of_the_player_are_the_packages() -> None:
    version = json.loads((ROOT / "player" / "package.json").read_text(encoding="utf-8"))["version"]
    for path in (ROOT / "player" / "packages").glob("*/package.json"):
        assert json.loads(path.read_text(encoding="utf-8"))["version"] == version
    for path in EXAMPLES.glob("*/package.json"):
        dependencies = json.loads(path.read_text(encoding="utf-8"))["dependencies"]
        assert [needed for name, needed in dependencies.items() if "splatreel" in name] == [version]


def test_plain_page_plays(page: Page, tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "html", tmp_path / "site")
    (tmp_path / "site" / "player").symlink_to(STATIC)
    (tmp_path / "site" / "reel").symlink_to(GOLDEN)
    with host(tmp_path / "site") as site:
        page.goto(site)
        wait_for_picture(page)
        page.get_by_role("button", name="Go to the middle").click()
        page.wait_for_function("document.getElementById('time').value.startsWith('0.2 of 0.5 s')")
        page.goto("about:blank")  # ends its downloads before the host is gone


@pytest.mark.parametrize("name", ["vite", "react"])
def test_built_page_plays(page: Page, tmp_path: Path, name: str) -> None:
    with host(build(name, tmp_path)) as site:
        page.goto(site)
        wait_for_picture(page)
        page.wait_for_function("document.getElementById('status').textContent.includes('0.5 s')")
        page.goto("about:blank")  # ends its downloads before the host is gone


@pytest.mark.parametrize("name", ["three", "react-three-fiber", "playcanvas"])
def test_built_scene_plays(page: Page, tmp_path: Path, name: str) -> None:
    with host(build(name, tmp_path)) as site:
        page.goto(site)
        page.wait_for_function("document.getElementById('status').textContent.includes('0.5 s')")
        page.goto("about:blank")  # ends its downloads before the host is gone
