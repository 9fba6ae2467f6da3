"""The context menu, double taps at the sides, a hold, a part that repeats, and the media session."""

import time

import pytest
from playwright.sync_api import CDPSession, Page

from splatreel.play.server import Server
from tests.player.pages import PLAYER, let_frames_pass, let_time_pass, open_body, open_player
from tests.player.screens import described

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"


def tap_twice(fingers: CDPSession, x: int, y: int) -> None:
    """Tap twice, 100 milliseconds apart by the times of the events, however long a busy machine takes to send them."""
    now = time.time()
    for begin in (now, now + 0.1):
        for after, kind, points in ((0, "touchStart", [{"x": x, "y": y}]), (0.02, "touchEnd", [])):
            event = {"type": kind, "touchPoints": points, "timestamp": begin + after}
            fingers.send("Input.dispatchTouchEvent", event)


def test_a_right_click_opens_the_menu_and_a_right_drag_pans(page: Page, server: Server):
    described(page)
    open_player(page, server)
    menu = page.locator("splat-reel").get_by_role("menu")
    page.mouse.move(470, 300)
    page.mouse.down(button="right")
    page.mouse.move(420, 280, steps=3)
    page.mouse.up(button="right")
    let_frames_pass(page)
    assert menu.count() == 0
    page.mouse.click(475, 150, button="right")
    menu.wait_for()
    entries = menu.get_by_role("menuitem")
    names = ["Copy a link to this time and view", "Repeat a part", "Walk mode"]
    names += ["Statistics", "About this reel", "Keys and gestures"]
    assert entries.all_inner_texts() == names
    box = menu.bounding_box()
    assert box is not None
    assert box["x"] + box["width"] <= 480
    for _ in names[:3]:
        page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.locator("splat-reel .stats").get_by_text("Points").wait_for()
    assert menu.count() == 0
    assert page.evaluate(f"{REEL}.shadowRoot.activeElement === {PLAYER}.canvas")


def test_the_menu_copies_a_link_or_shows_it(page: Page, server: Server):
    copied = "navigator.clipboard.writeText = (text) => window.refuse ? Promise.reject() : Promise.resolve(window.copied = text)"
    page.add_init_script(copied)
    open_player(page, server)
    page.evaluate(f"{PLAYER}.currentTime = 0.2")
    for refuse in ("false", "true"):
        page.evaluate(f"window.refuse = {refuse}")
        page.locator("splat-reel canvas").focus()
        page.keyboard.press("Shift+F10")
        page.locator("splat-reel").get_by_role("menuitem", name="Copy a link").click()
        if refuse == "false":
            page.wait_for_function("window.copied?.includes('#t=0.2&view=')")
    page.locator("splat-reel").get_by_role("dialog", name="Share").wait_for()


def test_a_double_tap_at_a_side_steps_and_in_the_middle_focuses(phone: Page, server: Server, fingers: CDPSession):
    open_player(phone, server)
    phone.evaluate(f"{PLAYER}.currentTime = 0.2")
    step = phone.evaluate(f"0.2 * {PLAYER}.duration")
    for x, expected in ((300, 0.2 + step), (20, 0.2), (160, 0.2)):
        let_time_pass(phone, 400)  # no double tap with the one before
        tap_twice(fingers, x, 240)
        assert phone.evaluate(f"{PLAYER}.currentTime") == pytest.approx(expected)


def test_a_part_repeats(page: Page, server: Server):
    open_player(page, server, "?autoplay=0&loop=0")
    page.evaluate(f"{PLAYER}.currentTime = 0.1")
    page.keyboard.press("o")
    page.locator("splat-reel .toast").get_by_text("Repeats from 0:00.1").wait_for()
    page.evaluate(f"{PLAYER}.currentTime = 0.2")
    page.keyboard.press("o")
    page.wait_for_function(f"{REEL}.section?.length === 2 && {PLAYER}.currentTime === 0.1")
    page.locator("splat-reel .section").wait_for()
    page.evaluate(f"window.times = []; {PLAYER}.addEventListener('timeupdate', () => times.push({PLAYER}.currentTime))")
    page.keyboard.press("k")
    page.wait_for_function("times.filter((time, i) => time < times[i - 1]).length > 1")
    assert page.evaluate("Math.max(...times)") < 0.2


def test_the_media_session_shows_what_plays(page: Page, server: Server):
    page.add_init_script(
        "window.handlers = {}; navigator.mediaSession.setActionHandler = (name, handler) => (handlers[name] = handler)"
    )
    described(page)
    open_player(page, server)
    assert page.evaluate("navigator.mediaSession.metadata") is None
    page.evaluate(f"{PLAYER}.play()")
    page.wait_for_function("navigator.mediaSession.metadata !== null")
    shown = page.evaluate("[navigator.mediaSession.metadata.title, navigator.mediaSession.metadata.artist]")
    assert shown == ["A toy train on its round", "Ada Example"]
    page.evaluate("handlers.pause()")
    assert page.evaluate(f"[{PLAYER}.paused, navigator.mediaSession.playbackState]") == [True, "paused"]
    page.evaluate("handlers.seekto({seekTime: 0.3})")
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(0.3)
    page.evaluate(f"{REEL}.remove()")
    page.wait_for_function("navigator.mediaSession.metadata === null && handlers.play === null")


@pytest.mark.parametrize("style", ["transform: scale(0.5); transform-origin: 0 0", "zoom: 0.5", "zoom: 2"])
def test_a_scaled_page_has_the_menu_and_the_new_middle_where_the_pointer_is(page: Page, server: Server, style: str):
    size = "width: 400px; height: 260px"
    reel = f"<splat-reel src='reel/manifest.json' controls style='aspect-ratio: auto; {size}'></splat-reel>"
    open_body(page, server, f"<div style='{style}'>{reel}</div>")
    page.mouse.click(60, 40, button="right")
    menu = page.locator("splat-reel").get_by_role("menu")
    menu.wait_for()
    box = menu.bounding_box()
    assert box is not None
    assert [box["x"], box["y"]] == pytest.approx([60, 40], abs=1)
    page.keyboard.press("Escape")
    page.evaluate(f"{PLAYER}.camera.calm = true")
    scale = page.evaluate(f"{PLAYER}.canvas.getBoundingClientRect().width / 400")
    asked = page.evaluate_handle(
        f"(() => {{ const asked = []; const {{ stage }} = {PLAYER}; const of = stage.depthAt.bind(stage);"
        "stage.depthAt = (x, y) => (asked.push(x / stage.view.width, y / stage.view.height), of(x, y)); return asked; })()"
    )
    page.mouse.dblclick(scale * 100, scale * 65)
    assert asked.json_value()[:2] == pytest.approx([0.25, 0.25], abs=0.01)
