"""Controls on touch screens: taps show and hide them, hidden controls take no taps, and all are large enough."""

import pytest
from playwright.sync_api import Locator, Page

from splatreel.play.server import Server
from tests.player.pages import PLAYER, let_time_pass, open_player, wait_for_transitions

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"
IDLE = f"{REEL}.matches(':state(idle)')"
THUMB = 44
"""CSS pixels of a side that a finger hits."""


def open_playing(phone: Page, server: Server) -> None:
    """Open the page and play with a stopped clock and hidden controls."""
    open_player(phone, server)
    phone.evaluate(f"{PLAYER}.playbackRate = 0; {PLAYER}.currentTime = 0.2; {PLAYER}.play()")
    phone.wait_for_function(IDLE)


def test_every_tap_on_the_picture_shows_or_hides_the_controls(phone: Page, server: Server):
    open_playing(phone, server)
    seen = []
    for _ in range(4):
        phone.touchscreen.tap(160, 150)
        seen.append(phone.evaluate(IDLE))
        let_time_pass(phone, 400)  # not a double tap
    assert seen == [False, True, False, True]


def test_controls_that_do_not_show_take_no_taps(phone: Page, server: Server):
    open_playing(phone, server)
    boxes = phone.locator("splat-reel").locator(".play, .settings, .seek")
    places = [box for i in range(boxes.count()) if (box := boxes.nth(i).bounding_box())]
    assert len(places) == 3
    for place in places:
        let_time_pass(phone, 400)  # not a double tap
        assert phone.evaluate(IDLE)
        phone.touchscreen.tap(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
        assert phone.evaluate(f"[{PLAYER}.paused, {PLAYER}.currentTime, {IDLE}]") == [False, pytest.approx(0.2), False]
        assert phone.locator("splat-reel .menu").is_hidden()
        phone.touchscreen.tap(160, 150)  # away with them again


def test_the_focus_leaves_controls_that_go_and_the_keyboard_finds_them(page: Page, server: Server):
    open_player(page, server)
    page.evaluate(f"{PLAYER}.playbackRate = 0; {PLAYER}.currentTime = 0.2")
    page.locator("splat-reel").get_by_role("button", name="Play").click()
    page.wait_for_function(IDLE)
    page.locator("splat-reel .play").wait_for(state="hidden")
    assert page.evaluate(f"{REEL}.shadowRoot.activeElement === {PLAYER}.canvas") is True
    page.keyboard.press("Tab")
    assert page.evaluate(f"{REEL}.shadowRoot.activeElement.className") == "play"
    let_time_pass(page, 3000)  # after 2.6 seconds the controls would go
    assert page.evaluate(IDLE) is False  # the keyboard is in it


def assert_thick(targets: Locator) -> None:
    for i in range(targets.count()):
        box = targets.nth(i).bounding_box()
        if box is not None:
            assert min(box["width"], box["height"]) >= THUMB, targets.nth(i).evaluate("(target) => target.outerHTML")


def test_targets_are_as_large_as_fingers(phone: Page, server: Server):
    open_player(phone, server)
    reel = phone.locator("splat-reel")
    phone.evaluate(
        f"{REEL}.shadowRoot.querySelectorAll('.live, .headset, .ar').forEach((button) => (button.hidden = false))"
    )
    assert_thick(reel.locator(".row button, .seek"))
    assert phone.evaluate("document.documentElement.scrollWidth") <= 320
    last = reel.locator(".full").bounding_box()
    assert last is not None
    assert last["x"] + last["width"] <= 320
    reel.locator(".settings").tap()
    reel.locator(".menu").wait_for()
    assert_thick(reel.locator(".menu label, .menu button, .menu select"))
    reel.get_by_role("button", name="Keys and gestures").tap()
    reel.get_by_role("dialog").wait_for()
    assert_thick(reel.locator(".dialog button"))


def test_no_hover_sticks_to_what_was_tapped(phone: Page, server: Server):
    open_player(phone, server)
    reset = phone.locator("splat-reel .reset")
    reset.tap()
    wait_for_transitions(phone)
    assert reset.evaluate("(button) => button.matches(':hover')") is True
    assert reset.evaluate("(button) => getComputedStyle(button).backgroundColor").endswith(", 0)")  # nothing to see


def test_a_menu_that_goes_on_fades_at_its_end(phone: Page, server: Server):
    open_player(phone, server)
    phone.locator("splat-reel .settings").tap()
    menu = phone.locator("splat-reel .menu")
    menu.wait_for()
    fade = f"getComputedStyle({REEL}.shadowRoot.querySelector('.menu'), '::after').height"
    phone.wait_for_function(f"{fade} === '56px'")
    menu.evaluate("(menu) => menu.scrollTo(0, menu.scrollHeight)")
    phone.wait_for_function(f"{fade} !== '56px'")


def test_the_help_of_a_phone_begins_with_gestures_and_folds_the_keys_away(phone: Page, server: Server):
    open_player(phone, server)
    phone.locator("splat-reel .settings").tap()
    phone.locator("splat-reel").get_by_role("button", name="Keys and gestures").tap()
    dialog = phone.locator("splat-reel").get_by_role("dialog")
    dialog.get_by_text("Double tap at a side").wait_for()
    assert dialog.locator("kbd:visible").count() == 0
    dialog.get_by_text("Keyboard").tap()
    dialog.locator("kbd").first.wait_for()


def test_fields_to_share_are_as_high_as_their_buttons(page: Page, server: Server):
    open_player(page, server)
    page.locator("splat-reel .settings").click()
    page.locator("splat-reel").get_by_role("button", name="Share").click()
    page.locator("splat-reel .field textarea").first.wait_for()
    heights = "(all) => all.map((one) => one.getBoundingClientRect().height)"
    fields = page.locator("splat-reel .field:not([hidden]) :is(textarea, button)").evaluate_all(heights)
    assert len(fields) >= 4
    assert max(fields) - min(fields) < 1
