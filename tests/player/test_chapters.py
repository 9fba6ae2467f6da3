"""Reels of version 2 in a real Chromium: chapters in pages as Python draws them, a live reel that drops its beginning."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("playwright.sync_api", reason="the browser tests need the playwright package")
from playwright.sync_api import Page

from splatreel.play.player_page import write_standalone
from splatreel.play.server import serve
from splatreel.play.timeline import open_reel
from tests.golden_long import LONG, WINDOW
from tests.player.pages import PLAYER, expect_problems, open_player, wait_for_picture
from tests.player.test_browser import picture, psnr

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"
BORDER = 1.05
"""Seconds: one chapter is half faded into the next."""


def test_chapters_in_pages_are_drawn_as_python_draws_them(page: Page):
    reel = open_reel(LONG)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url.split("/reel/")[-1]))
    with serve(LONG, port=0) as server:
        open_player(page, server, "?autoplay=0&loop=0")
        page.evaluate(f"{PLAYER}.rendition = 'high'")
        page.wait_for_function(f"!{PLAYER}.busy")
        assert [name for name in asked if name.startswith("pages/")].count("pages/000000.json") == 1
        asked.clear()
        for seconds in (1.75, BORDER, 1.0, 1.09, 0.85, 0.05):
            want = np.clip(reel.render(reel.at(seconds), reel.manifest.camera), 0, 1)
            assert want.std() > 0.02  # it is a dark reel
            assert psnr(picture(page, seconds, reel.manifest.camera), want) >= 55, seconds
        assert len(asked) == len(set(asked)), "nothing is fetched twice"


def test_who_joins_late_fetches_one_page_and_the_layers_that_live_there(page: Page):
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url.split("/reel/")[-1]))
    with serve(LONG, port=0) as server:
        page.goto(server.url + "?autoplay=0&loop=0#t=1.35")  # group 6, which has been alone for a while
        wait_for_picture(page)
        page.wait_for_function(f"!{PLAYER}.busy")
    needed = ["0000.safetensors", "0005.safetensors", "0006.safetensors"]
    assert sorted(name for name in asked if name.startswith("layers/")) == [f"layers/{name}" for name in needed]
    assert [name for name in asked if name.startswith("pages/")] == ["pages/000006.json"]


def test_a_live_reel_that_drops_its_beginning_moves_who_is_there_to_its_new_one(page: Page):
    # The last file of what is dropped is asked for before the manifest that says so is read.
    expect_problems(page, "404")
    before = json.loads((WINDOW / "manifest.json").read_text())
    after = before | {"first_group": before["first_group"] + before["pages"][0]["groups"], "pages": before["pages"][1:]}
    states = [before]
    first, later = (state["pages"][0]["first_frame"] / before["fps"] for state in (before, after))
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=states[-1]))
    with serve(WINDOW, port=0) as server:
        open_player(page, server, "?autoplay=0&loop=0#t=0.1")
        assert page.evaluate(f"[{REEL}.currentTime, {REEL}.seekable.start(0)]") == [first, first]
        page.evaluate(f"{PLAYER}.currentTime = {REEL}.duration")
        page.wait_for_function(f"!{PLAYER}.seeking")
        page.keyboard.press("Home")
        page.wait_for_function(f"!{PLAYER}.seeking")
        assert page.evaluate(f"{PLAYER}.currentTime") == first
        assert (
            page.locator("splat-reel input.seek").evaluate("bar => [Number(bar.min), Number(bar.value)]") == [first] * 2
        )
        states.append(after)
        page.wait_for_function(f"{REEL}.seekable.start(0) === {later} && !{PLAYER}.seeking")
        assert page.evaluate(f"[{REEL}.currentTime, {REEL}.error, {PLAYER}.stage.scene.current.group]") == [
            later,
            None,
            after["first_group"],
        ]


def test_a_folder_and_one_file_hold_all_chapters(page: Page, tmp_path: Path):
    write_standalone(tmp_path / "reel.html", LONG)
    folder = shutil.copytree(LONG, tmp_path / "long")
    page.goto((tmp_path / "reel.html").as_uri() + "?autoplay=0&loop=0")
    for _ in range(2):
        wait_for_picture(page)
        page.evaluate(f"{PLAYER}.currentTime = {BORDER}")
        page.wait_for_function(f"!{PLAYER}.seeking && {PLAYER}.stage.scene.layers.length === 4")
        page.locator("splat-reel input.folder").set_input_files(folder)
        page.wait_for_function(f"{PLAYER}.manifest?.files.name === 'long'")
