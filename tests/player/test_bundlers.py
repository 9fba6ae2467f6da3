"""`import "splatreel-player"` in pages that Vite, webpack, esbuild and Rollup build, and without a bundler."""

import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Page

from splatreel.play.player_page import STATIC
from tests.golden import GOLDEN
from tests.player.engines import PLAYER, snippet_of
from tests.player.hosts import host
from tests.player.pages import wait_for_picture

pytestmark = [pytest.mark.browser, pytest.mark.slow]

TOOLS = Path(__file__).parent / "bundlers"
PACKAGE = PLAYER / "package.json"
EXAMPLES = PLAYER.parent / "examples"
HTML = """<!doctype html><html><head><link rel="icon" href="data:," />{head}</head><body>
<splat-reel src="{reel}manifest.json" controls share></splat-reel>
<script type="module" src="./main.js"></script></body></html>"""
IMPORT_MAP = """<script type="importmap">
{"imports": {"splatreel-player": "./node_modules/splatreel-player/dist/player.js"}}</script>"""


@pytest.fixture(scope="session")
def tools(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the bundlers that `tests/player/bundlers/package-lock.json` pins."""
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("the bundlers need node and npm")
    folder = tmp_path_factory.mktemp("bundlers")
    for name in ("package.json", "package-lock.json", "build.mjs"):
        shutil.copy(TOOLS / name, folder)
    command = [npm, "ci", "--no-audit", "--no-fund", "--ignore-scripts"]
    try:
        result = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    except subprocess.TimeoutExpired:
        pytest.skip("npm does not install the bundlers within five minutes: is there a package registry?")
    if result.returncode != 0:
        pytest.skip(f"npm cannot install the bundlers: {result.stderr.strip()[-300:]}")
    return folder


def write_app(folder: Path, reel: str, head: str = "") -> Path:
    """Write a page that imports the player from its package."""
    app = folder / "app"
    shutil.rmtree(app, ignore_errors=True)
    package = app / "node_modules" / "splatreel-player"
    shutil.copytree(STATIC, package / "dist")
    shutil.copy(PACKAGE, package)
    dependencies = {"name": "app", "private": True, "type": "module", "dependencies": {"splatreel-player": "*"}}
    (app / "package.json").write_text(json.dumps(dependencies))
    (app / "main.js").write_text(
        'import { SplatReelElement } from "splatreel-player";\nwindow.Reel = SplatReelElement;\n'
    )
    (app / "index.html").write_text(HTML.format(reel=reel, head=head))
    return app


def assert_plays(page: Page, address: str) -> None:
    """Assert that the page decodes (Draco and H.265, in workers with WASM), sorts, and loads parts on demand."""
    page.goto(address)
    wait_for_picture(page)
    reel = page.locator("splat-reel")
    reel.get_by_role("button", name="Settings").click()
    reel.get_by_role("button", name="Camera path").click()
    reel.get_by_role("button", name="Close the camera path").click()
    reel.get_by_role("button", name="Settings").click()
    reel.locator(".menu").get_by_role("button", name="Share").click()
    reel.get_by_role("dialog", name="Share").wait_for()


@contextmanager
def reel_host() -> Iterator[str]:
    with host(GOLDEN, headers={"Access-Control-Allow-Origin": "*"}) as address:
        yield address


@pytest.mark.parametrize("bundler", ["vite", "webpack", "esbuild", "rollup"])
def test_a_built_page_plays(page: Page, tools: Path, bundler: str) -> None:
    with reel_host() as reel:
        app = write_app(tools, reel)
        command = ["node", "build.mjs", bundler]
        result = subprocess.run(command, cwd=tools, capture_output=True, text=True, timeout=300)
        assert result.returncode == 0, result.stdout + result.stderr
        assert result.stdout + result.stderr == "", "no bundler warns of anything"
        shutil.rmtree(app / "node_modules")
        with host(app / "dist") as site:
            assert_plays(page, site)
            # A page's own script cannot be embedded in other pages.
            assert page.locator("splat-reel textarea[name=element]").is_hidden()
            page.goto("about:blank")  # ends its downloads before the host is gone


def test_the_development_server_of_vite_plays(page: Page, tools: Path) -> None:
    with reel_host() as reel:
        write_app(tools, reel)
        command = ["node", "build.mjs", "vite-dev"]
        with subprocess.Popen(
            command, cwd=tools, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as server:
            try:
                assert server.stdout
                assert_plays(page, server.stdout.readline().strip())
            finally:
                server.terminate()


def test_a_page_without_a_bundler_plays(page: Page, tmp_path: Path) -> None:
    with reel_host() as reel:
        app = write_app(tmp_path, reel, IMPORT_MAP)
        with host(app) as site:
            assert_plays(page, site)
            element = page.locator("splat-reel textarea[name=element]")
            assert f'src="{site}node_modules/splatreel-player/dist/player.js"' in element.input_value()
            page.goto("about:blank")  # ends its downloads before the host is gone


SERVER = """import React from "react";
import { renderToString } from "react-dom/server";
import { Reel } from "./Reel.jsx";
export const render = () => renderToString(React.createElement(Reel, { src: "reel/manifest.json", label: "A room" }));
"""


def test_a_server_renders_the_react_example(tools: Path) -> None:
    """Frameworks import the player in Node when they render a page."""
    app = write_app(tools, "reel/")
    shutil.copy(EXAMPLES / "react" / "Reel.jsx", app)
    (app / "server.jsx").write_text(SERVER)
    command = ["node", "build.mjs", "vite-ssr"]
    result = subprocess.run(command, cwd=tools, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stdout + result.stderr
    assert '<splat-reel src="reel/manifest.json"' in result.stdout
    assert 'aria-label="A room"' in result.stdout


@pytest.mark.parametrize("name", ["three", "playcanvas"])
def test_code_of_the_docs_is_typescript(name: str, tmp_path: Path) -> None:
    """It compiles under `strict` against the types of the package."""
    paths = {f"@splatreel/{name}": [str(PLAYER / "packages" / name / "src" / "index.ts")]}
    errors = type_check(tmp_path, snippet_of(name), "ts", paths)
    assert errors == ""
    wrong = (
        snippet_of(name).replace("loadedmetadata", "loadedmetadat").replace("viewFromStart(camera)", "viewFromStart()")
    )
    assert "error TS" in type_check(tmp_path, wrong, "ts", paths)


def test_react_knows_the_element(tools: Path, tmp_path: Path) -> None:
    """The code of docs/player.md compiles against `splatreel-player/react`, and wrong attributes do not."""
    code = (PLAYER.parent / "docs" / "player.md").read_text(encoding="utf-8").split("```tsx\n")[1].split("```")[0]
    types = tools / "node_modules" / "@types"
    paths = {
        "splatreel-player": [str(PLAYER / "packages" / "element" / "src" / "main.ts")],
        "splatreel-player/react": [str(PLAYER / "react.d.ts")],
        "react": [str(types / "react" / "index.d.ts")],
        "react/jsx-runtime": [str(types / "react" / "jsx-runtime.d.ts")],
        "csstype": [str(tools / "node_modules" / "csstype")],
    }
    assert type_check(tmp_path, code, "tsx", paths) == ""
    assert "error TS2322" in type_check(tmp_path, code.replace("autoplay", "autoplay={3}"), "tsx", paths)


def type_check(folder: Path, code: str, suffix: str, paths: dict[str, list[str]]) -> str:
    """Return what TypeScript says about code under the settings of the player. paths: of further modules."""
    modules = PLAYER / "node_modules"
    settings = json.loads((PLAYER / "tsconfig.json").read_text())["compilerOptions"]
    own = {name: [str(PLAYER / path) for path in found] for name, found in settings["paths"].items()}
    engines = {"three": [str(modules / "@types" / "three")], "playcanvas": [str(modules / "playcanvas")]}
    options = settings | {"paths": own | engines | paths, "jsx": "react-jsx", "noUnusedLocals": False}
    files = [
        folder / f"snippet.{suffix}",
        PLAYER / "packages/element/src/files.d.ts",
        PLAYER / "packages/decoder/src/modules.d.ts",
    ]
    files[0].write_text(code, encoding="utf-8")
    config = {"compilerOptions": options, "files": [str(file) for file in files]}
    (folder / "tsconfig.json").write_text(json.dumps(config))
    command = ["node", str(modules / "typescript" / "bin" / "tsc"), "-p", str(folder)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=600)
    return result.stdout + result.stderr


def test_the_lock_file_names_no_host() -> None:
    assert "resolved" not in (TOOLS / "package-lock.json").read_text()
