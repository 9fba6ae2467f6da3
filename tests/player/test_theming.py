"""Styles of the page reach the controls by `::part` and custom properties; slots hold the page's own elements."""

import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server
from tests.player.pages import PLAYER, open_body, wait_for_style

pytestmark = pytest.mark.browser

STYLE = """<style>
splat-reel { width: 480px; height: 320px; aspect-ratio: auto; --accent: rgb(200, 0, 100); --surface: rgb(0, 60, 0); }
splat-reel::part(play) { background: rgb(1, 2, 3); }
splat-reel::part(menu) { border-radius: 0; }
splat-reel::part(cue) { font-size: 30px; }
#logo { position: absolute; top: 10px; left: 10px; pointer-events: auto; }
</style>"""
REEL = """<splat-reel src="reel/manifest.json" controls>
  <button id="logo" slot="overlay" onclick="window.clicked = 'logo'">Logo</button>
  <button id="like" slot="bar" onclick="window.clicked = 'like'">Like</button>
</splat-reel>"""


def style(page: Page, selector: str, name: str) -> str:
    return page.locator(f"splat-reel {selector}").evaluate(f"(one) => getComputedStyle(one).{name}")


def test_parts_and_properties_change_the_controls(page: Page, server: Server):
    open_body(page, server, STYLE + REEL)
    assert style(page, ".play", "backgroundColor") == "rgb(1, 2, 3)"
    page.locator("splat-reel .settings").click()
    page.locator("splat-reel .menu").wait_for()
    assert style(page, ".menu", "borderRadius") == "0px"
    assert style(page, ".menu", "backgroundColor") == "rgb(0, 60, 0)"
    assert style(page, ".menu [name=loop]", "backgroundColor") != "rgb(200, 0, 100)"
    page.locator("splat-reel").get_by_label("Loop").check()
    wait_for_style(page, ".menu [name=loop]", "backgroundColor", "rgb(200, 0, 100)")


def test_slots_hold_elements_over_the_picture_and_in_the_bar(page: Page, server: Server):
    open_body(page, server, STYLE + REEL)
    like, settings = page.locator("#like").bounding_box(), page.locator("splat-reel .settings").bounding_box()
    assert like
    assert settings
    assert abs(like["y"] + like["height"] / 2 - settings["y"] - settings["height"] / 2) < 2
    for name in ("logo", "like"):
        page.locator(f"#{name}").click()
        assert page.evaluate("window.clicked") == name
    before = page.evaluate(f"{PLAYER}.camera.state.eye")
    page.mouse.move(240, 100)
    page.mouse.down()
    page.mouse.move(280, 100)
    page.mouse.up()
    assert page.evaluate(f"{PLAYER}.camera.state.eye") != before, "the overlay leaves gestures to the picture"


@pytest.mark.parametrize("supported", [True, False], ids=["states", "attributes"])
def test_states_of_the_player_leave_the_classes_of_the_page_alone(page: Page, server: Server, supported: bool):
    """Browsers without `:state()` get attributes instead."""
    if not supported:
        page.add_init_script("CSS.supports = () => false")
    open_body(page, server, f"<style>.idle, .clear {{ display: none }}</style>{STYLE}{REEL}")
    page.evaluate(f"{PLAYER}.playbackRate = 0; {PLAYER}.play()")
    wait_for_style(page, ".bar", "visibility", "hidden")
    element = page.locator("splat-reel")
    names = element.evaluate("(one) => [one.className, one.matches(':state(idle)'), one.dataset.splatreelIdle ?? null]")
    assert names == ["", supported, None if supported else ""]
    assert element.is_visible()
    element.evaluate("(one) => (one.toggleAttribute('transparent', true), one.pause())")
    wait_for_style(page, ".bar", "visibility", "visible")
    assert element.evaluate("(one) => getComputedStyle(one).backgroundColor") == "rgba(0, 0, 0, 0)"
