"""Keys, mouse, touch, menu, links, and the element as pages use it."""

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

from splatreel.play.server import Server, serve
from splatreel.play.timeline import open_reel
from tests.flashes import GOLDEN as SOUND
from tests.golden import GOLDEN
from tests.player.pages import PLAYER, open_body, open_player, wait_until_near

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"


@pytest.mark.smoke
def test_keys_move_time_and_play(page: Page, server: Server):
    open_player(page, server)
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("End")
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(open_reel(GOLDEN).duration)
    page.keyboard.press("Home")
    assert page.evaluate(f"{PLAYER}.currentTime") == 0
    page.keyboard.press("Space")
    assert page.evaluate(f"{PLAYER}.paused") is False


def test_the_mouse_moves_the_camera_and_reset_brings_it_back(page: Page, server: Server):
    open_player(page, server)
    pose = f"{PLAYER}.camera.viewmat"
    start = page.evaluate(pose)
    page.mouse.move(200, 100)
    page.mouse.down()
    page.mouse.move(260, 120, steps=4)
    page.mouse.up()
    turned = page.evaluate(pose)
    page.mouse.wheel(0, 200)
    assert not np.allclose(start, turned, atol=0.01)
    page.wait_for_function(f"Math.abs({pose}[11] - {turned[11]}) > 1e-5")
    page.locator("splat-reel").get_by_role("button", name="Reset view").click()
    wait_until_near(page, pose, start, 1e-6)


def test_the_controls_fit_a_narrow_screen(page: Page, server: Server):
    page.set_viewport_size({"width": 320, "height": 480})
    open_player(page, server)
    for name in ("Play", "Reset view", "Settings", "Fullscreen"):
        box = page.locator("splat-reel .row").get_by_role("button", name=name).bounding_box()
        assert box is not None
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 320
    assert page.evaluate("document.documentElement.scrollWidth") <= 320


def test_no_two_buttons_have_one_name(page: Page, server: Server):
    open_player(page, server)
    reel = page.locator("splat-reel")
    reel.locator(".start").wait_for()
    names = reel.locator("button:visible").evaluate_all("(all) => all.map((one) => one.ariaLabel || one.textContent)")
    assert {"Play", "Start the reel"} <= set(names)
    assert len(names) == len(set(names))


def test_every_key_does_what_the_help_says(page: Page, server: Server):
    open_player(page, server)
    page.locator("splat-reel canvas").focus()
    time = f"{PLAYER}.currentTime"
    duration = open_reel(GOLDEN).duration
    for key, expected in [("5", 0.5), ("ArrowRight", 0.6), ("l", 0.8), ("j", 0.6), ("ArrowLeft", 0.5), ("0", 0)]:
        page.keyboard.press(key)
        assert page.evaluate(time) == pytest.approx(expected * duration)
    page.keyboard.press(".")
    assert page.evaluate(time) == pytest.approx(1 / 30)
    page.keyboard.press(",")
    assert page.evaluate(time) == 0
    page.keyboard.press(">")
    assert page.evaluate(f"{PLAYER}.playbackRate") == 1.25
    page.keyboard.press("i")
    page.locator("splat-reel .stats").get_by_text("Points").wait_for()
    page.keyboard.press("?")
    help = page.locator("splat-reel").get_by_role("dialog", name="Keys and gestures")
    assert "Fullscreen" in help.inner_text()
    page.keyboard.press("Escape")
    assert help.is_hidden()
    page.keyboard.press("c")
    assert page.evaluate(f"{PLAYER}.camera.flying") is True


def test_one_tab_stop_and_arrows_inside(page: Page, server: Server):
    open_player(page, server)
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("Tab")
    label = f"{REEL}.shadowRoot.activeElement.getAttribute('aria-label')"
    names = [page.evaluate(label)]
    for key in ("ArrowRight", "ArrowRight", "ArrowRight", "ArrowUp", "ArrowDown"):
        page.keyboard.press(key)
        names.append(page.evaluate(label))
    assert names == ["Play", "Reset view", "Settings", "Fullscreen", "Seek", "Play"]
    page.keyboard.press("Tab")
    assert page.evaluate(f"{REEL}.shadowRoot.activeElement") is None


def test_a_double_click_makes_what_is_seen_the_middle(page: Page, server: Server):
    open_player(page, server)
    start = page.evaluate(f"{PLAYER}.camera.viewmat")
    page.mouse.dblclick(270, 200)  # well inside of what is seen
    page.wait_for_function(f"{PLAYER}.camera.viewmat.some((value, i) => Math.abs(value - {start}[i]) > 1e-3)")
    # A slow device draws fewer pixels than the canvas shows.
    depth = f"{PLAYER}.stage.depthAt({PLAYER}.canvas.width / 2, {PLAYER}.canvas.height / 2)"
    wait_until_near(page, f"{depth} / {PLAYER}.camera.state.distance", 1.0, 0.1)


def test_two_fingers_zoom_and_move(browser: Browser, server: Server):
    page = browser.new_page(viewport={"width": 320, "height": 300}, has_touch=True)
    open_player(page, server)
    before = page.evaluate(f"{PLAYER}.camera.state.distance")
    touch = page.context.new_cdp_session(page)
    fingers = [([100, 150], [220, 150]), ([60, 150], [260, 150])]
    for kind, points in zip(("touchStart", "touchMove"), fingers, strict=True):
        points = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    wait_until_near(page, f"{PLAYER}.camera.state.distance", before * 120 / 200, 0.06 * before)
    page.close()


def test_the_menu_sets_speed_and_loop(page: Page, server: Server):
    open_player(page, server)
    reel = page.locator("splat-reel")
    reel.get_by_role("button", name="Settings").click()
    reel.get_by_label("Speed").select_option("0.5")
    reel.get_by_label("Loop").uncheck()
    assert page.evaluate(f"[{REEL}.playbackRate, {REEL}.loop]") == [0.5, False]
    page.keyboard.press("Escape")
    assert reel.locator(".menu").is_hidden()


def test_a_link_holds_time_and_view(page: Page, server: Server):
    open_player(page, server)
    view = [1, 0, 0, 0.25, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1]
    link = page.evaluate(
        f"(view) => {{ {REEL}.camera = {{viewmat: view}}; {REEL}.currentTime = 0.2; return {REEL}.link; }}", view
    )
    page.goto("about:blank")
    page.goto(link)
    page.wait_for_function(f"{REEL}?.readyState >= 2")
    assert page.evaluate(f"{REEL}.currentTime") == pytest.approx(0.2)
    assert np.allclose(page.evaluate(f"{REEL}.camera.viewmat"), view, atol=1e-3)


def test_less_motion_for_those_who_ask_for_it(browser: Browser, server: Server):
    page = browser.new_page(viewport={"width": 320, "height": 200}, reduced_motion="reduce")
    open_player(page, server, "")
    assert page.evaluate(f"[{REEL}.paused, {PLAYER}.camera.calm]") == [True, True]
    page.close()


def test_escape_closes_what_is_around_the_player_if_nothing_in_it_is_open(page: Page, server: Server):
    size = "style='width: 300px; height: 200px; aspect-ratio: auto'"
    reel = f"<splat-reel src='reel/manifest.json' controls {size}></splat-reel>"
    open_body(page, server, f"<dialog>{reel}</dialog><script>document.querySelector('dialog').showModal()</script>")
    opened = "document.querySelector('dialog').open"
    page.locator("splat-reel .settings").click()
    page.locator("splat-reel .menu").wait_for()
    page.keyboard.press("Escape")
    assert page.locator("splat-reel .menu").is_hidden()
    assert page.evaluate(opened) is True
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("Escape")
    page.wait_for_function(f"!{opened}")


def test_the_bar_is_one_tab_stop_and_arrows_lead_through_it(page: Page):
    with serve(SOUND, port=0) as server:
        page.set_viewport_size({"width": 640, "height": 360})
        open_player(page, server)
        focus = f"{REEL}.shadowRoot.activeElement?.className"
        stops = []
        for _ in range(3):
            page.keyboard.press("Tab")
            stops.append(page.evaluate(focus))
        assert stops == ["", "play", None]
        page.locator("splat-reel .play").focus()
        for name in ("mute", "level", "reset", "settings"):
            page.keyboard.press("ArrowRight")
            assert page.evaluate(focus) == name
        assert page.evaluate(f"[{REEL}.volume, {REEL}.currentTime]") == [1, 0]
        page.locator("splat-reel .full").focus()
        page.keyboard.press("Tab")
        assert page.evaluate(focus) is None, "no other button is a tab stop"
