"""Walk mode: pointer lock and keys, a stick and drags on a touch screen, and how it ends."""

import numpy as np
import pytest
from playwright.sync_api import CDPSession, Page

from splatreel.play.server import Server
from tests.player.pages import PLAYER, open_player
from tests.player.test_gestures import touch

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"
LOCKED = f"{REEL}.shadowRoot.pointerLockElement !== null"
WALK = "splat-reel .walk"


def eye(page: Page) -> np.ndarray:
    return np.array(page.evaluate(f"{PLAYER}.camera.state.eye"))


def direction(page: Page) -> np.ndarray:
    return np.array(page.evaluate(f"{PLAYER}.camera.viewmat.slice(8, 11)"))


def begin(page: Page, server: Server) -> None:
    open_player(page, server)
    page.evaluate(f"{PLAYER}.currentTime = 0.1")
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("g")
    page.locator(WALK).wait_for()


def wait_for_move(page: Page, before: np.ndarray, what: str = "state.eye") -> None:
    at = f"{PLAYER}.camera.{what}"
    page.wait_for_function(f"Math.hypot(...{at}.map((value, i) => value - {before.tolist()}[i])) > 0.05")


def test_the_mouse_looks_around_and_keys_walk_until_escape(page: Page, server: Server) -> None:
    begin(page, server)
    page.wait_for_function(LOCKED)
    assert "W A S D" in page.locator("splat-reel .toast").inner_text()
    start, ahead = eye(page), direction(page)
    page.mouse.move(100, 100)
    page.mouse.move(220, 100)
    wait_for_move(page, ahead, "viewmat.slice(8, 11)")
    np.testing.assert_allclose(eye(page), start, atol=1e-6)
    page.keyboard.down("w")
    wait_for_move(page, start)
    page.keyboard.up("w")
    page.evaluate("document.exitPointerLock()")  # as the browser does at Esc, which it does not tell the page
    page.locator(WALK).wait_for(state="detached")
    assert page.evaluate(f"{PLAYER}.camera.driver === null && {REEL}.shadowRoot.activeElement === {PLAYER}.canvas")


def test_without_pointer_lock_drags_look_around(page: Page, server: Server) -> None:
    page.add_init_script("Element.prototype.requestPointerLock = () => Promise.reject(new DOMException('no'))")
    begin(page, server)
    start, ahead = eye(page), direction(page)
    page.mouse.move(200, 100)
    page.mouse.down()
    page.mouse.move(300, 100)
    page.mouse.up()
    wait_for_move(page, ahead, "viewmat.slice(8, 11)")
    np.testing.assert_allclose(eye(page), start, atol=1e-6)
    page.keyboard.press("Escape")
    page.locator(WALK).wait_for(state="detached")


def test_menus_and_a_button_begin_and_end_it(page: Page, server: Server) -> None:
    page.add_init_script("Element.prototype.requestPointerLock = () => Promise.reject(new DOMException('no'))")
    open_player(page, server)
    reel = page.locator("splat-reel")
    reel.get_by_role("button", name="Settings").click()
    reel.locator(".menu").get_by_role("button", name="Walk mode").click()
    reel.get_by_role("group", name="Walk mode").wait_for()
    reel.get_by_role("button", name="Leave walk mode").click()
    page.locator(WALK).wait_for(state="detached")
    page.locator("splat-reel canvas").click(button="right", position={"x": 60, "y": 60})
    reel.get_by_role("menuitem", name="Walk mode").click()
    page.locator(WALK).wait_for()
    page.evaluate(f"{REEL}.removeAttribute('src')")
    page.locator(WALK).wait_for(state="detached")


def test_two_thumbs_walk_and_look_at_once(phone: Page, fingers: CDPSession, server: Server) -> None:
    begin(phone, server)
    box = phone.locator("splat-reel .stick").bounding_box()
    assert box is not None
    assert phone.evaluate(LOCKED) is False
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    start, ahead = eye(phone), direction(phone)
    touch(fingers, "touchStart", (x, y))
    touch(fingers, "touchMove", (x, y - 50))
    wait_for_move(phone, start)
    touch(fingers, "touchStart", (x, y - 50), (250, 120))
    touch(fingers, "touchMove", (x, y - 50), (290, 120))
    wait_for_move(phone, ahead, "viewmat.slice(8, 11)")
    touch(fingers, "touchEnd")
    assert phone.locator("splat-reel .stick i").evaluate("(knob) => knob.style.translate") in ("0%", "0% 0%")
    assert "thumb" in phone.locator("splat-reel .toast").inner_text()
    phone.locator("splat-reel").get_by_role("button", name="Leave walk mode").tap()
    phone.locator(WALK).wait_for(state="detached")
