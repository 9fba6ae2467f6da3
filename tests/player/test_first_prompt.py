"""The player tells first-time viewers that they can look around."""

import pytest
from playwright.sync_api import Browser, Locator, Page, Route

from splatreel.play.server import Server
from tests.player.pages import PLAYER, let_frames_pass, open_player, wait_for_picture, wait_until

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
    let_frames_pass(page)
    assert prompt.count() == 0, "the visitor knows by now"


APART = """(others) => {
  const root = document.querySelector('splat-reel').shadowRoot;
  const box = root.querySelector('.prompt');
  if (getComputedStyle(box).visibility === 'hidden') return [];
  const prompt = box.getBoundingClientRect();
  const meets = (a) => a.width > 0 && a.left < prompt.right && a.right > prompt.left && a.top < prompt.bottom && a.bottom > prompt.top;
  return [...root.querySelectorAll(others)].filter((other) => meets(other.getBoundingClientRect())).map((other) => other.className);
}"""
OTHERS = ".start, .wait p, .spinner, .cue, .toast.shown, .bar .row, .seek, .menu, .path-panel, .edit-drawing circle"


def open_paused_prompt(page: Page, server: Server, query: str = "?autoplay=0") -> Locator:
    """Open the player, and keep the prompt from fading."""
    open_player(page, server, query)
    prompt = page.locator(PROMPT)
    prompt.evaluate("(prompt) => prompt.getAnimations().forEach((animation) => animation.pause())")
    return prompt


def wait_for_place(page: Page) -> None:
    page.evaluate("new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))")


def test_it_lies_beside_the_play_button_in_windows_of_any_size(page: Page, server: Server) -> None:
    prompt = open_paused_prompt(page, server)
    page.locator("splat-reel .start").wait_for()
    for width, height in [(320, 240), (400, 225), (480, 270), (640, 360), (360, 640), (200, 120), (320, 180)]:
        page.set_viewport_size({"width": width, "height": height})
        wait_for_place(page)
        assert prompt.is_visible(), (width, height)
        assert page.evaluate(APART, OTHERS) == [], (width, height)
        box = prompt.bounding_box()
        assert box
        assert min(box["x"], box["y"]) >= 0
        assert box["x"] + box["width"] <= width


def test_it_makes_way_for_messages_menus_and_editors(page: Page, server: Server) -> None:
    page.route("**/groups/0001.safetensors", lambda route: None)
    prompt = open_paused_prompt(page, server)
    page.evaluate(f"{PLAYER}.currentTime = 0.3")
    page.locator("splat-reel .wait.long").wait_for()
    page.locator("splat-reel .wait p").evaluate("(line) => (line.textContent = 'Retrying. '.repeat(20))")
    wait_for_place(page)
    assert page.evaluate(APART, OTHERS) == []
    page.evaluate(f"{PLAYER}.currentTime = 0")
    reel = page.locator("splat-reel")
    reel.get_by_role("button", name="Settings").click()
    reel.locator(".menu").wait_for()
    wait_for_place(page)
    assert page.evaluate(APART, OTHERS) == []
    reel.get_by_role("button", name="Crop and clean").click()
    reel.locator(".edit-drawing").wait_for()
    wait_for_place(page)
    assert prompt.is_hidden()
    reel.get_by_role("button", name="Close the editor").click()
    wait_for_place(page)
    assert prompt.is_visible()


def test_a_page_with_its_own_instructions_switches_it_off(page: Page, server: Server) -> None:
    body = '<script type="module" src="player.js"></script><splat-reel src="reel/manifest.json" prompt="none">'
    page.route("**/embed.html", lambda route: route.fulfill(content_type="text/html", body=body))
    for name in ("embed.html", "self-test.html"):
        page.goto(server.url + name)
        wait_for_picture(page)
        wait_for_place(page)
        assert page.locator(PROMPT).count() == 0


PAUSE = """document.querySelectorAll('splat-reel').forEach((reel) => reel.player.addEventListener('canplay', () =>
  reel.shadowRoot.querySelector('.prompt')?.getAnimations().forEach((animation) => animation.pause())))"""


def test_it_goes_by_itself_and_one_page_shows_it_once(page: Page, server: Server) -> None:
    body = '<script type="module" src="player.js"></script>' + 2 * '<splat-reel src="reel/manifest.json"></splat-reel>'
    page.route("**/embed.html", lambda route: route.fulfill(content_type="text/html", body=body))
    held: list[Route] = []
    page.route("**/layers/*", lambda route: held.append(route))
    page.goto(server.url + "embed.html")
    page.wait_for_function("[...document.querySelectorAll('splat-reel')].every((reel) => reel.player)")
    page.evaluate(PAUSE)
    wait_until(page, lambda: held)
    for route in held:
        route.continue_()
    page.unroute("**/layers/*")
    page.wait_for_function("[...document.querySelectorAll('splat-reel')].every((reel) => reel.player?.canPlay)")
    prompt = page.locator(PROMPT)
    assert prompt.count() == 1
    prompt.evaluate("(prompt) => prompt.getAnimations().forEach((animation) => animation.finish())")
    prompt.wait_for(state="detached")


def test_it_is_not_for_those_who_asked_for_less_motion(browser: Browser, server: Server) -> None:
    page = browser.new_page(viewport={"width": 480, "height": 320}, reduced_motion="reduce")
    open_player(page, server)
    let_frames_pass(page)
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
