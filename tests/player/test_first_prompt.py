"""The player tells first-time viewers that they can look around."""

import pytest
from playwright.sync_api import Browser, Page

from splatreel.play.server import Server
from tests.player.pages import PLAYER, open_player

pytestmark = pytest.mark.browser

PROMPT = "splat-reel .prompt"


def test_it_shows_once_and_goes_with_the_first_gesture(page: Page, server: Server) -> None:
    open_player(page, server)
    prompt = page.locator(PROMPT)
    prompt.evaluate("(prompt) => prompt.getAnimations().forEach((animation) => animation.pause())")
    assert prompt.inner_text() == "Drag to look around"
    assert prompt.evaluate("(prompt) => getComputedStyle(prompt).pointerEvents") == "none"
    page.evaluate(f"{PLAYER}.currentTime = 0.1")
    page.wait_for_function(f"!{PLAYER}.seeking")
    assert prompt.count() == 1, "time is no gesture"
    page.mouse.move(100, 100)
    page.mouse.down()
    page.mouse.move(140, 100, steps=4)
    prompt.wait_for(state="detached")
    page.mouse.up()
    open_player(page, server)
    page.wait_for_timeout(200)
    assert prompt.count() == 0, "the visitor knows by now"


def test_it_goes_by_itself_and_one_page_shows_it_once(page: Page, server: Server) -> None:
    body = '<script type="module" src="player.js"></script>' + 2 * '<splat-reel src="reel/manifest.json"></splat-reel>'
    page.route("**/embed.html", lambda route: route.fulfill(content_type="text/html", body=body))
    page.goto(server.url + "embed.html")
    page.wait_for_function("[...document.querySelectorAll('splat-reel')].every((reel) => reel.player?.canPlay)")
    prompt = page.locator(PROMPT)
    assert prompt.count() == 1
    prompt.evaluate("(prompt) => prompt.getAnimations().forEach((animation) => animation.finish())")
    prompt.wait_for(state="detached")


def test_it_is_not_for_those_who_asked_for_less_motion(browser: Browser, server: Server) -> None:
    page = browser.new_page(viewport={"width": 480, "height": 320}, reduced_motion="reduce")
    open_player(page, server)
    page.wait_for_timeout(200)
    assert page.locator(PROMPT).count() == 0
    page.close()


def test_a_finger_in_an_article_is_told_what_it_can_do(phone: Page, server: Server) -> None:
    open_player(phone, server)
    assert phone.locator(PROMPT).inner_text() == "Drag to look around"
    phone.evaluate("localStorage.clear()")
    body = """<meta name="viewport" content="width=device-width"><script type="module" src="player.js"></script>
<splat-reel src="reel/manifest.json"></splat-reel><p style="height: 2000px"></p>"""
    phone.route("**/embed.html", lambda route: route.fulfill(content_type="text/html", body=body))
    phone.goto(server.url + "embed.html")
    phone.locator(PROMPT).wait_for()
    assert phone.locator(PROMPT).inner_text() == "Use two fingers to look around"
