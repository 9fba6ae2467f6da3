"""Wheel and touch in a scrolling page: the page gets them until the viewer chooses the image."""

import numpy as np
import pytest
from playwright.sync_api import CDPSession, Page

from splatreel.play.server import Server
from tests.player.pages import PLAYER, let_frames_pass, let_time_pass, open_player, wait_for_picture

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"
HINT = ".gestures.shown"
ARTICLE = """<!doctype html><meta name="viewport" content="width=device-width"><style>body {{ margin: 0 }}</style>
<script type="module" src="player.js"></script><p style="height: 100px">Once upon a time</p>
<splat-reel src="reel/manifest.json" controls {attributes} style="width: 320px; height: 240px; aspect-ratio: auto"></splat-reel>
<p style="height: 2000px">The end</p>"""


def open_article(page: Page, server: Server, attributes: str = "") -> None:
    body = ARTICLE.format(attributes=attributes)
    page.route("**/article.html", lambda route: route.fulfill(content_type="text/html", body=body))
    page.goto(server.url + "article.html")
    wait_for_picture(page)
    page.evaluate(f"{PLAYER}.camera.calm = true; {PLAYER}.currentTime = 0.1")  # later than where the big button is
    page.wait_for_function(f"!{PLAYER}.seeking")


def scrolled(page: Page) -> float:
    """Return the page's scroll position, after the pause that separates two wheel gestures."""
    let_time_pass(page, 700)
    return page.evaluate("scrollY")


def distance(page: Page) -> float:
    return page.evaluate(f"{PLAYER}.camera.state.distance")


def pose(page: Page) -> list[float]:
    return page.evaluate(f"{PLAYER}.camera.viewmat")


def touch(fingers: CDPSession, kind: str, *points: tuple[float, float]) -> None:
    at = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
    fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})


def swipe(fingers: CDPSession, page: Page, x: int, y: int) -> None:
    """Swipe with one finger from the middle of the reel."""
    touch(fingers, "touchStart", (160, 180))
    for part in np.linspace(0.1, 1, 10):
        let_frames_pass(page, 1)
        touch(fingers, "touchMove", (160 + part * x, 180 + part * y))
    touch(fingers, "touchEnd")


def pinch(fingers: CDPSession) -> None:
    """Spread two fingers, one above the other, from 80 to 160 pixels apart."""
    for kind, half in (("touchStart", 40), ("touchMove", 60), ("touchMove", 80)):
        touch(fingers, kind, (160, 180 - half), (160, 180 + half))
    touch(fingers, "touchEnd")


def test_the_wheel_scrolls_an_article_and_zooms_once_the_picture_was_clicked(page: Page, server: Server):
    open_article(page, server)
    start = distance(page)
    page.mouse.move(160, 180)
    page.mouse.wheel(0, 60)
    assert scrolled(page) == 60
    assert distance(page) == start
    assert "+ scroll to zoom" in page.locator("splat-reel").locator(HINT).inner_text()
    page.keyboard.down("Control")
    page.mouse.wheel(0, 100)
    page.keyboard.up("Control")
    assert scrolled(page) == 60
    assert distance(page) > start
    page.mouse.click(160, 100)
    before = distance(page)
    page.mouse.wheel(0, 100)
    assert scrolled(page) == 60
    assert distance(page) > before
    page.keyboard.press("Escape")
    page.mouse.wheel(0, 20)
    assert scrolled(page) == 80
    page.mouse.click(160, 100)
    page.mouse.click(400, 100)  # outside
    page.mouse.move(160, 100)
    page.mouse.wheel(0, 20)
    assert scrolled(page) == 100


def test_a_mouse_turns_the_picture_in_an_article_at_once(page: Page, server: Server):
    open_article(page, server)
    before = pose(page)
    page.mouse.move(160, 180)
    page.mouse.down()
    page.mouse.move(200, 190, steps=3)
    page.mouse.up()
    assert not np.allclose(pose(page), before, atol=0.01)


def test_one_finger_scrolls_an_article_and_turns_once_the_picture_was_tapped(
    phone: Page, server: Server, fingers: CDPSession
):
    open_article(phone, server)
    before = pose(phone)
    swipe(fingers, phone, 0, -60)
    assert scrolled(phone) == pytest.approx(60, abs=20)
    assert np.allclose(pose(phone), before)
    assert phone.locator("splat-reel .gestures").inner_text() == "Use two fingers to move the view"
    phone.evaluate("scrollTo(0, 0)")
    phone.touchscreen.tap(160, 180)
    swipe(fingers, phone, 30, -50)
    assert scrolled(phone) == 0
    assert not np.allclose(pose(phone), before, atol=0.01)
    phone.touchscreen.tap(160, 50)  # outside
    turned = pose(phone)
    swipe(fingers, phone, 0, -60)
    assert scrolled(phone) == pytest.approx(60, abs=20)
    assert np.allclose(pose(phone), turned)


def test_two_fingers_move_the_picture_in_an_article(phone: Page, server: Server, fingers: CDPSession):
    open_article(phone, server)
    before = distance(phone)
    pinch(fingers)
    assert scrolled(phone) == 0
    assert distance(phone) == pytest.approx(before / 2, rel=0.1)
    assert phone.locator("splat-reel").locator(HINT).count() == 0


def test_the_attribute_decides(page: Page, server: Server):
    open_article(page, server, 'gestures="greedy"')
    before = distance(page)
    page.mouse.move(160, 180)
    page.mouse.wheel(0, 60)
    assert scrolled(page) == 0
    assert distance(page) > before
    page.evaluate(f"{REEL}.setAttribute('gestures', 'cooperative')")
    page.mouse.wheel(0, 60)
    assert scrolled(page) == 60
    page.evaluate(f"{REEL}.states.toggle('filling', true)")  # what is the whole window has nothing to scroll
    before = distance(page)
    page.mouse.wheel(0, 60)
    assert scrolled(page) == 60
    assert distance(page) > before


def test_the_reels_own_page_gives_it_everything_and_a_frame_does_not(page: Page, server: Server):
    open_player(page, server)
    before = distance(page)
    page.mouse.move(160, 100)
    page.mouse.wheel(0, 60)
    page.wait_for_function(f"{PLAYER}.camera.state.distance > {before}")
    body = '<body style="height: 3000px; margin: 0"><iframe src="./?autoplay=0" width="320" height="240"></iframe>'
    page.route("**/framed.html", lambda route: route.fulfill(content_type="text/html", body=body))
    page.goto(server.url + "framed.html")
    frame = page.frames[1]
    frame.wait_for_function(f"{REEL}?.player?.canPlay")
    page.mouse.move(60, 60)
    page.mouse.wheel(0, 60)
    frame.locator("splat-reel").locator(HINT).wait_for(state="attached")
    assert scrolled(page) == 60


def start_button(page: Page) -> tuple[float, float]:
    box = page.locator("splat-reel .start").bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_drags_and_the_wheel_on_the_big_button_are_the_pictures(page: Page, server: Server):
    open_player(page, server)
    x, y = start_button(page)
    before, far = pose(page), distance(page)
    page.mouse.move(x, y)
    page.mouse.wheel(0, 100)
    page.wait_for_function(f"{PLAYER}.camera.state.distance > {far}")
    page.mouse.down()
    page.mouse.move(x + 60, y + 20, steps=6)
    page.mouse.move(x, y, steps=6)  # back on the button
    assert not np.allclose(pose(page), before, atol=0.01)
    page.mouse.up()
    assert page.evaluate(f"{PLAYER}.paused")
    page.mouse.down(button="right")
    page.mouse.move(x + 40, y, steps=4)
    page.mouse.up(button="right")
    assert page.evaluate(f"[{PLAYER}.paused, {PLAYER}.camera.viewmat[3] > 0.05]") == [True, True]
    page.mouse.click(x, y)
    assert not page.evaluate(f"{PLAYER}.paused")


def test_on_the_big_button_a_finger_turns_two_pinch_and_a_tap_plays(phone: Page, server: Server, fingers: CDPSession):
    open_player(phone, server)
    x, y = start_button(phone)
    before, far = pose(phone), distance(phone)
    touch(fingers, "touchStart", (x, y))
    for step in range(1, 7):
        touch(fingers, "touchMove", (x + 10 * step, y))
    touch(fingers, "touchEnd")
    assert not np.allclose(pose(phone), before, atol=0.01)
    for half in (8, 20, 40):
        touch(fingers, "touchStart" if half == 8 else "touchMove", (x, y - half), (x, y + half))
    touch(fingers, "touchEnd")
    assert distance(phone) < 0.5 * far
    assert phone.evaluate(f"{PLAYER}.paused")
    phone.touchscreen.tap(x, y)
    assert not phone.evaluate(f"{PLAYER}.paused")


def test_in_an_article_the_hint_is_not_covered_and_a_finger_on_the_big_button_scrolls(
    phone: Page, server: Server, fingers: CDPSession
):
    open_article(phone, server)
    phone.evaluate(f"{PLAYER}.currentTime = 0")
    phone.locator("splat-reel .start").wait_for()
    x, y = start_button(phone)
    before = pose(phone)
    touch(fingers, "touchStart", (x, y))
    for step in range(1, 9):
        let_frames_pass(phone, 1)
        touch(fingers, "touchMove", (x, y - 8 * step))
    touch(fingers, "touchEnd")
    assert scrolled(phone) > 20
    assert np.allclose(pose(phone), before)
    assert phone.evaluate(f"{PLAYER}.paused")


def test_the_big_button_leaves_the_hint_in_sight(page: Page, server: Server):
    open_article(page, server)
    page.evaluate(f"{PLAYER}.currentTime = 0")
    page.locator("splat-reel .start").wait_for()
    x, y = start_button(page)
    page.mouse.move(x, y)
    page.mouse.wheel(0, 30)
    page.locator("splat-reel").locator(HINT).wait_for()
    assert page.locator("splat-reel .start").is_hidden()
    page.locator("splat-reel .start").wait_for()  # once the hint has gone
