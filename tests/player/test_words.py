"""Texts of the player: help for the available input devices, times, and errors in plain words."""

import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server
from tests.player.pages import PLAYER, expect_problems, open_player, wait_for_picture

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"


def test_help_begins_with_gestures_on_a_touch_screen_and_closes_by_a_tap_outside(phone: Page, server: Server):
    open_player(phone, server)
    reel = phone.locator("splat-reel")
    reel.get_by_role("button", name="Settings").tap()
    reel.get_by_role("button", name="Keys and gestures").tap()
    reel.get_by_role("dialog").wait_for()
    assert reel.locator(".dialog h3:visible").all_inner_texts() == ["Touch"]
    reel.get_by_text("Keyboard").tap()
    assert reel.locator(".dialog h3:visible").all_inner_texts() == ["Touch", "Time", "View"]
    phone.evaluate(f"{REEL}.shadowRoot.querySelector('.dialog').style.height = '200px'")
    phone.touchscreen.tap(160, 20)
    assert reel.get_by_role("dialog").is_hidden()


def test_help_closes_by_escape_and_by_a_click_outside(page: Page, server: Server):
    page.set_viewport_size({"width": 800, "height": 600})
    open_player(page, server)
    help = page.locator("splat-reel").get_by_role("dialog")
    page.keyboard.press("?")
    help.wait_for()
    assert page.locator("splat-reel .dialog h3").all_inner_texts() == ["Time", "Mouse", "View"]
    page.keyboard.press("Escape")
    assert help.is_hidden()
    page.keyboard.press("?")
    help.wait_for()
    page.mouse.click(10, 300)
    assert help.is_hidden()


def test_keys_work_on_the_reels_own_page_at_once_but_not_in_a_field(page: Page, server: Server):
    open_player(page, server)
    page.keyboard.press("5")
    time = page.evaluate(f"{PLAYER}.currentTime")
    assert time == pytest.approx(page.evaluate(f"{PLAYER}.duration / 2"))
    page.evaluate("document.body.prepend(document.createElement('input'))")
    page.get_by_role("textbox").press_sequentially("0 ")
    assert page.evaluate(f"[{PLAYER}.currentTime, {PLAYER}.paused]") == [time, True]
    assert page.get_by_role("textbox").input_value() == "0 "


def test_keys_of_a_page_that_embeds_a_reel_are_the_pages(page: Page, server: Server):
    body = '<script type="module" src="player.js"></script><splat-reel src="reel/manifest.json" controls></splat-reel>'
    page.route("**/embed.html", lambda route: route.fulfill(content_type="text/html", body=body))
    page.goto(server.url + "embed.html")
    wait_for_picture(page)
    page.keyboard.press("5")
    assert page.evaluate(f"{PLAYER}.currentTime") == 0
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("5")
    assert page.evaluate(f"{PLAYER}.currentTime") > 0


def test_short_reels_show_tenths(page: Page, server: Server):
    open_player(page, server)
    page.evaluate(f"{PLAYER}.currentTime = 0.2")
    assert page.locator("splat-reel .time").inner_text() == "0:00.2 / 0:00.4"
    assert page.locator("splat-reel .seek").get_attribute("aria-valuetext") == "0:00.2 of 0:00.4"


def test_a_missing_reel_is_said_plainly_and_its_address_is_a_detail(page: Page, server: Server):
    expect_problems(page, "404")
    page.route("**/reel/manifest.json", lambda route: route.fulfill(status=404, body="not here"))
    page.goto(server.url + "?src=reel/manifest.json")
    panel = page.locator("splat-reel").get_by_role("alert")
    panel.wait_for()
    words = panel.inner_text()
    assert "This reel cannot be played" in words
    assert "There is no reel at this address" in words
    assert "manifest.json" not in words
    panel.get_by_text("Details").click()
    assert f"{server.url}reel/manifest.json cannot be downloaded: it answered 404" in panel.inner_text()


def test_a_failure_amid_playing_is_called_that(page: Page, server: Server):
    expect_problems(page, "404")
    page.route("**/groups/0001*", lambda route: route.fulfill(status=404, body="not here"))
    open_player(page, server)
    page.evaluate(f"{PLAYER}.currentTime = 0.3")
    panel = page.locator("splat-reel").get_by_role("alert")
    panel.wait_for()
    assert panel.get_by_role("heading").inner_text() == "Playback stopped"
    assert "a part of it is missing" in panel.inner_text()


def test_a_damaged_reel_beside_the_page_is_an_error_and_not_an_invitation(page: Page, server: Server):
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json={"format": "splatreel", "version": 1}))
    page.goto(server.url)
    panel = page.locator("splat-reel").get_by_role("alert")
    panel.wait_for()
    assert "damaged" in panel.inner_text()
    assert page.locator("splat-reel .drop").is_hidden()
