"""Private reels: a signed query, cookies, headers or signed addresses go to every file of a reel."""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page

from splatreel.play.player_page import STATIC
from tests.flashes import GOLDEN as SOUND
from tests.golden_long import LONG
from tests.player.engines import write_site
from tests.player.hosts import host
from tests.player.pages import PLAYER, wait_for_picture, wait_until
from tests.player.test_first_pictures import jpeg

pytestmark = pytest.mark.browser

TOKEN = "token=s3cret"
REEL = "document.querySelector('splat-reel')"
ROOT = f"{REEL}.shadowRoot"
PAGE = """<!doctype html><link rel="icon" href="data:," /><script type="module" src="player.js"></script>
<splat-reel {attributes} controls></splat-reel><script type="module">{script}</script>"""
HEADERS = "({ headers: { Authorization: 'token=s3cret' } })"


def write_reel(source: Path, folder: Path) -> Path:
    """Copy a reel, and add a poster and thumbnails."""
    reel = Path(shutil.copytree(source, folder / "reel"))
    manifest = json.loads((reel / "manifest.json").read_text())
    (reel / "poster.jpg").write_bytes(data := jpeg((200, 30, 40)))
    entry = {"uri": "poster.jpg", "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    sheets = {"width": 32, "height": 24, "columns": 1, "rows": 1, "seconds": 1, "count": 1, "sheets": [entry]}
    manifest |= {"poster": entry | {"width": 32, "height": 24}, "thumbnails": sheets}
    (reel / "manifest.json").write_text(json.dumps(manifest))
    return reel


class Gate:
    """A host's check of requests, and the paths that it refused and admitted."""

    def __init__(self) -> None:
        self.refused: list[str] = []
        self.admitted: list[str] = []

    def __call__(self, request: Any) -> bool:
        names = ("Authorization", "Cookie")
        given = any(TOKEN in text for text in [request.path, *(request.headers.get(name, "") for name in names)])
        (self.admitted if given else self.refused).append(request.path.split("?")[0])
        return given


def cors(origin: str) -> dict[str, str]:
    return {
        "Access-Control-Allow-Origin": origin.rstrip("/"),
        "Access-Control-Allow-Credentials": "true",
        "Access-Control-Allow-Headers": "authorization, range",
    }


OPEN = f"Object.assign({REEL}, {{ request: %s, src: '{{reel}}manifest.json' }})"
WAYS = {
    "query": ("src='{reel}manifest.json?token=s3cret'", ""),
    "cookies": ("src='{reel}manifest.json' crossorigin='use-credentials'", ""),
    "headers": ("", OPEN % f"async () => {HEADERS}"),
    "addresses": ("", OPEN % "(url) => ({ url: url + '?token=s3cret' })"),
}
"""Attributes and script of a page, by how it asks for the reel."""


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("source", [SOUND, LONG], ids=["sound", "pages"])
def test_each_file_of_a_private_reel_is_asked_for_with_its_token(page: Page, tmp_path: Path, source: Path, way: str):
    gate, reel = Gate(), write_reel(source, tmp_path)
    attributes, script = WAYS[way]
    pages = {"/page.html": ""}
    with host(STATIC, pages) as site, host(reel, headers=cors(site), admits=gate) as data:
        if way == "cookies":
            page.context.add_cookies([{"name": "token", "value": "s3cret", "url": data}])
        fill = {"attributes": attributes.replace("{reel}", data), "script": script.replace("{reel}", data)}
        pages["/page.html"] = PAGE.format(**fill)
        page.goto(f"{site}page.html")
        wait_for_picture(page)
        page.locator("splat-reel .seek").hover()
        page.wait_for_function(f"{ROOT}.querySelector('.thumbnail img')?.naturalWidth === 32")
        if source == SOUND:
            page.locator("splat-reel .start").click()
            wait_until(page, lambda: "/sound/0001.m4s" in gate.admitted)
        page.evaluate(f"{PLAYER}.pause(), {PLAYER}.currentTime = {PLAYER}.duration")
        page.wait_for_function(f"!{PLAYER}.seeking && !{PLAYER}.waiting")
        page.goto("about:blank")  # ends its downloads before the host is gone
    assert gate.refused == []
    kinds = {path.split("/")[1] for path in gate.admitted}
    assert kinds >= {"manifest.json", "layers", "groups", "poster.jpg"} | ({"sound"} if source == SOUND else {"pages"})


def test_the_bundled_page_sends_cookies_if_it_is_asked_to(page: Page, tmp_path: Path):
    gate, reel = Gate(), write_reel(SOUND, tmp_path)
    with host(STATIC) as site, host(reel, headers=cors(site), admits=gate) as data:
        page.context.add_cookies([{"name": "token", "value": "s3cret", "url": data}])
        page.goto(f"{site}index.html?autoplay=0&crossorigin=use-credentials&src={data}manifest.json")
        wait_for_picture(page)
        page.goto("about:blank")
    assert gate.refused == []


@pytest.mark.parametrize("way", ["{ request: () => HEADERS }", "{ credentials: 'include' }"])
@pytest.mark.parametrize("name", ["three", "playcanvas"])
def test_engines_ask_for_private_reels(page: Page, tmp_path: Path, name: str, way: str):
    gate = Gate()
    engine = write_site(tmp_path, name, "reel-object" if name == "three" else "reel-script")
    shutil.copytree(engine, tmp_path / name, ignore=shutil.ignore_patterns("*.d.ts", "playcanvas.dbg*", "*.prf*"))
    if name == "three":
        shutil.copytree(engine.parent / "examples" / "jsm", tmp_path / "addons")
    with host(tmp_path) as site, host(tmp_path / "reel", headers=cors(site), admits=gate) as data:
        if "credentials" in way:
            page.context.add_cookies([{"name": "token", "value": "s3cret", "url": data}])
        page.goto(site)
        page.wait_for_function("window.events")
        options = way.replace("HEADERS", HEADERS)
        found = page.evaluate(
            f"openReel('{data}manifest.json', {options}).then((reel) => [reel.canPlay, reel.error?.message ?? null])"
        )
        page.goto("about:blank")
    assert found == [True, None]
    assert gate.refused == []
    assert any("groups" in path for path in gate.admitted)
