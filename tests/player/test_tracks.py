"""Captions and chapters of `<track>` children: shown in time, chosen by button, menu and keys, marked on the bar."""

import pytest
from playwright.sync_api import Locator, Page

from splatreel.play.server import Server
from tests.player.pages import PLAYER, add_file, expect_problems, open_body, wait_until

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"
ENGLISH = "WEBVTT\n\n00:00.000 --> 00:00.200\nA <i>ball</i> rises\n\n00:00.200 --> 00:00.400 line:10%\nIt falls"
HEBREW = "WEBVTT\n\n00:00.000 --> 00:00.400\nכדור עולה!"
CHAPTERS = "WEBVTT\n\n00:00.000 --> 00:00.250\nRise\n\n00:00.250 --> 00:00.400\nFall &amp; rest"
TRACKS = """<track kind="captions" src="en.vtt" srclang="en" label="English" default>
<track kind="subtitles" src="he.vtt" srclang="he"><track kind="chapters" src="chapters.vtt">"""


def open_tracks(
    page: Page, server: Server, tracks: str = TRACKS, size: tuple[int, int] = (480, 320), attributes: str = "controls"
) -> Locator:
    for name, text in {"en.vtt": ENGLISH, "he.vtt": HEBREW, "chapters.vtt": CHAPTERS}.items():
        add_file(page, name, text)
    style = f"width: {size[0]}px; height: {size[1]}px; aspect-ratio: auto"
    reel = f'<splat-reel src="reel/manifest.json" {attributes} style="{style}">{tracks}</splat-reel>'
    open_body(page, server, reel, 'lang="en" dir="rtl"')
    return page.locator("splat-reel")


def test_captions_follow_the_time_without_controls(page: Page, server: Server):
    reel = open_tracks(page, server, attributes="")
    reel.locator(".cue").get_by_text("A ball rises").wait_for()
    assert reel.locator(".cue i").inner_text() == "ball"
    page.evaluate(f"{PLAYER}.currentTime = 0.3")
    reel.locator(".cue").get_by_text("It falls").wait_for()
    assert reel.locator(".cue").count() == 1
    box = reel.locator(".cue").bounding_box()
    assert box is not None
    assert box["y"] < 100, "the cue names a line near the top"


def test_the_first_prompt_leaves_captions_free(page: Page, server: Server):
    reel = open_tracks(page, server)
    prompt, cue = reel.locator(".prompt"), reel.locator(".cue")
    prompt.evaluate("(prompt) => prompt.getAnimations().forEach((animation) => animation.pause())")
    cue.get_by_text("A ball rises").wait_for()
    high, low = prompt.bounding_box(), cue.bounding_box()
    assert high is not None
    assert low is not None
    assert high["y"] + high["height"] < low["y"]


def test_a_long_title_stays_within_the_menu(page: Page, server: Server):
    add_file(page, "long.vtt", f"WEBVTT\n\n00:00.000 --> 00:00.400\n{'The locomotive leaves the station at noon' * 3}")
    reel = open_tracks(page, server, '<track kind="chapters" src="long.vtt">')
    reel.get_by_role("button", name="Settings").click()
    reel.locator(".menu [name=chapter]").wait_for()
    edges = reel.locator(".menu, .menu *").evaluate_all("(all) => all.map((one) => one.getBoundingClientRect().right)")
    assert max(edges) == edges[0]
    assert reel.locator(".menu").evaluate("(menu) => menu.scrollWidth <= menu.clientWidth")


def test_button_menu_and_key_choose_captions(page: Page, server: Server):
    reel = open_tracks(page, server)
    button = reel.get_by_role("button", name="Captions")
    button.wait_for()
    assert button.get_attribute("aria-pressed") == "true"
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("t")
    assert reel.locator(".cue").count() == 0
    assert page.evaluate(f"{REEL}.getAttribute('captions')") == "off"
    button.click()
    reel.locator(".cue").get_by_text("A ball rises").wait_for()
    reel.get_by_role("button", name="Settings").click()
    choice = reel.locator("[name=captions]")
    choice.locator("option").nth(2).wait_for(state="attached")  # the menu is loaded on demand
    assert choice.locator("option").all_inner_texts() == ["Off", "English", "עברית"]
    choice.select_option("עברית")
    reel.locator(".cue").get_by_text("כדור").wait_for()
    assert reel.locator(".cues").get_attribute("lang") == "he"
    page.evaluate(f"{REEL}.setAttribute('captions', 'en')")
    reel.locator(".cue").get_by_text("A ball rises").wait_for()


def test_chapters_are_marked_named_and_reached(page: Page, server: Server):
    reel = open_tracks(page, server)
    reel.locator(".marks i").wait_for(state="attached")
    assert reel.locator(".marks i").evaluate_all("(marks) => marks.map((mark) => mark.style.left)") == ["53.57%"]
    assert reel.locator(".seek").get_attribute("aria-valuetext") == "0:00.0 of 0:00.4, Rise"
    page.locator("splat-reel canvas").focus()
    page.keyboard.press("n")
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(0.25)
    page.keyboard.press("b")
    assert page.evaluate(f"{PLAYER}.currentTime") == 0
    reel.get_by_role("button", name="Settings").click()
    reel.get_by_label("Chapter").select_option("Fall & rest")
    assert page.evaluate(f"{PLAYER}.currentTime") == pytest.approx(0.25)
    track = reel.locator(".seek").bounding_box()
    assert track is not None
    page.mouse.move(track["x"] + 0.8 * track["width"], track["y"] + track["height"] / 2)
    assert reel.locator(".hint").inner_text() == "Fall & rest\n0:00.3"


def test_tracks_come_and_go(page: Page, server: Server):
    reel = open_tracks(page, server, tracks="")
    button = reel.get_by_role("button", name="Captions")
    assert not button.is_visible()
    page.evaluate(f"{REEL}.innerHTML = `{TRACKS}`")
    reel.locator(".cue").get_by_text("A ball rises").wait_for()
    button.wait_for()
    page.evaluate(f"{REEL}.replaceChildren()")
    reel.locator(".cue").wait_for(state="detached")
    button.wait_for(state="hidden")
    assert reel.locator(".marks i").count() == 0


def test_a_track_that_cannot_be_used_is_named(page: Page, server: Server):
    expect_problems(page, "404")
    warnings: list[str] = []
    page.on("console", lambda message: warnings.append(message.text) if message.type == "warning" else None)
    reel = open_tracks(page, server, tracks='<track src="en.vtt" srclang="en" label="English">')
    page.route("**/none.vtt", lambda route: route.fulfill(status=404, body=""))
    page.route("**/page.vtt", lambda route: route.fulfill(body="<!doctype html>"))
    for name, cause in (("none.vtt", "it answered 404"), ("page.vtt", "it is not WebVTT")):
        page.evaluate(f'{REEL}.innerHTML = \'<track src="{name}" srclang="en" default>\'')
        reel.locator(".toast").get_by_text("These captions cannot be loaded").wait_for()
        message = f"{name} cannot be used: {cause}"
        wait_until(page, lambda message=message: any(message in text for text in warnings))


@pytest.mark.parametrize("size", [(390, 220), (200, 120)])
def test_captions_stay_within_small_embeds(page: Page, server: Server, size: tuple[int, int]):
    reel = open_tracks(page, server, size=size)
    reel.locator(".cue").get_by_text("A ball rises").wait_for()
    cue, button, box = (reel.locator(name).bounding_box() for name in (".cue > span", ".play", ".ui"))
    assert cue
    assert button
    assert box
    assert cue["x"] >= box["x"]
    assert cue["x"] + cue["width"] <= box["x"] + size[0]
    assert cue["y"] >= 0
    assert cue["y"] + cue["height"] <= button["y"] + 2
