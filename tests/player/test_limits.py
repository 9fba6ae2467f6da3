"""View limits: a view beyond them returns, and its image fades meanwhile."""

import json

import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server
from tests.golden import GOLDEN
from tests.player.pages import PLAYER, let_frames_pass, open_player

pytestmark = pytest.mark.browser

COLOR = "getComputedStyle(document.querySelector('splat-reel').shadowRoot.querySelector('.beyond')).backgroundColor"


def open_limited(page: Page, server: Server) -> None:
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    manifest |= {"limits": {"focus": [0, 0, 0], "angle": 20}, "background": [1, 0.5, 0]}
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))
    open_player(page, server)


def test_who_turns_beyond_the_cameras_sees_less_is_told_and_comes_back(page: Page, server: Server):
    open_limited(page, server)
    words = page.locator("splat-reel .beyond").get_by_text("No camera looked from here")
    page.mouse.move(100, 150)
    page.mouse.down()
    page.mouse.move(300, 150, steps=5)  # by more than a right angle
    words.wait_for()
    color = page.evaluate(COLOR)
    assert float(color[:-1].split(",")[3]) > 0.5
    assert color.startswith("rgba(255, 128, 0,")
    page.mouse.up()
    words.wait_for(state="hidden")
    page.wait_for_function(f"{PLAYER}.camera.offCameraFade < 0.001")


def test_a_pose_that_a_page_sets_is_shown_as_it_is(page: Page, server: Server):
    open_limited(page, server)
    pose = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 4, 0, 0, 0, 1]  # from behind
    page.evaluate("viewmat => { document.querySelector('splat-reel').camera = { viewmat } }", pose)
    let_frames_pass(page)
    assert page.evaluate(f"{PLAYER}.camera.viewmat") == pytest.approx(pose, abs=1e-6)
    assert page.evaluate(f"{PLAYER}.camera.offCameraFade") == 0
