"""Sharing from the player: links, embedding code, images, and the description of the reel."""

import io
import json
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Frame, Locator, Page

from splatreel.play.server import Server, serve
from tests.golden import GOLDEN
from tests.player.pages import PLAYER, open_player, wait_for_picture

pytestmark = pytest.mark.browser

REEL = "document.querySelector('splat-reel')"
WORDS = {"title": "A <b>toy</b> train", "author": "Ada", "description": "On <i>its</i> round", "licence": "CC BY 4.0"}


def say(page: Page) -> None:
    """Give the reel a description."""
    manifest = json.loads((GOLDEN / "manifest.json").read_text()) | WORDS
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))


def choose(page: Page | Frame, entry: str) -> Locator:
    """Open a menu entry."""
    reel = page.locator("splat-reel")
    reel.get_by_role("button", name="Settings").click()
    reel.locator(".menu").get_by_role("button", name=entry).click()
    dialog = reel.get_by_role("dialog")
    dialog.wait_for()
    return dialog


@pytest.fixture
def plain(browser: Browser) -> Iterator[Page]:
    """A page without permissions, with two device pixels per CSS pixel."""
    page = browser.new_page(viewport={"width": 480, "height": 400}, device_scale_factor=2)
    yield page
    page.close()


def test_the_share_dialog_has_a_link_code_that_embeds_and_a_code_to_scan(page: Page, server: Server):
    say(page)
    page.set_viewport_size({"width": 800, "height": 560})
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    open_player(page, server)
    page.evaluate(f"{PLAYER}.currentTime = 0.2")
    link = page.evaluate(f"{REEL}.link")
    dialog = choose(page, "Share")
    assert dialog.get_by_label("Link", exact=True).input_value() == link
    dialog.get_by_role("button", name="Copy: Link").click()
    page.locator("splat-reel").get_by_text("Copied").wait_for()
    assert page.evaluate("navigator.clipboard.readText()") == link
    shot = np.asarray(Image.open(io.BytesIO(dialog.locator(".code").screenshot())).convert("L"))
    assert cv2.QRCodeDetector().detectAndDecode(shot)[0] == link
    frame = dialog.get_by_label("Embed in a page, as a frame", exact=True).input_value()
    assert 'allow="fullscreen; clipboard-write; xr-spatial-tracking; autoplay"' in frame
    page.set_content(frame)  # what it says is what was shared
    assert page.locator("iframe").get_attribute("src") == link
    assert page.locator("iframe").get_attribute("title") == WORDS["title"]


def test_the_share_dialog_without_time_and_view_and_as_an_element(page: Page, server: Server):
    open_player(page, server)
    dialog = choose(page, "Share")
    dialog.get_by_label("At this time and view").uncheck()
    assert dialog.get_by_label("Link", exact=True).input_value() == f"{server.url}?autoplay=0"
    code = dialog.get_by_label("Embed in a page, as an element", exact=True).input_value()
    page.route("**/embed.html", lambda route: route.fulfill(content_type="text/html", body=code))
    page.goto(server.url + "embed.html")
    wait_for_picture(page)


def test_only_pages_that_take_links_share_them(page: Page, server: Server):
    open_player(page, server, "?autoplay=0&share=0")
    page.locator("splat-reel").get_by_role("button", name="Settings").click()
    menu = page.locator("splat-reel .menu")
    menu.wait_for()
    assert menu.get_by_role("button", name="Share").is_hidden()
    assert menu.get_by_role("button", name="About this reel").is_hidden()  # it says nothing


@pytest.fixture(scope="module")
def elsewhere() -> Iterator[Server]:
    """Address of another origin."""
    with serve(GOLDEN, port=0) as running:
        yield running


def open_frame(page: Page, server: Server, elsewhere: Server, allow: str) -> Frame:
    """Open the player in a frame of another origin."""
    address = f"{elsewhere.url}?autoplay=0"
    frame = f'<iframe src="{address}" allow="{allow}" width="480" height="400"></iframe>'
    page.goto(server.url + "THIRD_PARTY.txt")  # a page that was really served: others may not ask this machine
    page.evaluate("(frame) => (document.body.innerHTML = frame)", frame)
    page.locator("iframe").wait_for()
    frame = page.frames[1]
    frame.wait_for_function(f"{REEL}?.player?.canPlay")
    return frame


def test_a_frame_without_permissions_promises_nothing(plain: Page, server: Server, elsewhere: Server):
    frame = open_frame(plain, server, elsewhere, "")
    assert frame.locator("splat-reel .full").is_hidden()
    dialog = choose(frame, "Share")
    link = dialog.get_by_label("Link", exact=True)
    frame.evaluate("document.execCommand = () => false")  # nor the older way
    dialog.get_by_role("button", name="Copy: Link").click()
    frame.locator("splat-reel").get_by_text("Selected: copy it").wait_for()
    assert link.evaluate("(area) => area.selectionEnd - area.selectionStart === area.value.length") is True
    plain.keyboard.press("Escape")
    assert dialog.is_hidden()
    plain.close()


def test_a_frame_with_permissions_has_the_screen(plain: Page, server: Server, elsewhere: Server):
    frame = open_frame(plain, server, elsewhere, "fullscreen; clipboard-write")
    full = frame.locator("splat-reel .full")
    full.click()
    frame.wait_for_function("document.fullscreenElement !== null")
    assert full.get_attribute("aria-label") == "Leave fullscreen"


def test_a_refused_screen_is_said_and_a_window_can_be_filled(page: Page, server: Server):
    open_player(page, server)
    page.evaluate(f"void ({REEL}.requestFullscreen = () => Promise.reject(new TypeError()))")
    page.keyboard.press("f")
    page.locator("splat-reel").get_by_text("The browser does not allow fullscreen").wait_for()
    page.evaluate("Object.defineProperty(document, 'fullscreenEnabled', {value: false})")
    page.evaluate(f"{REEL}.style.width = '300px'")
    page.keyboard.press(".")  # anything happens
    full = page.locator("splat-reel .full")
    assert full.get_attribute("aria-label") == "Fill the window"
    full.click()
    assert page.locator("splat-reel").bounding_box() == {"x": 0, "y": 0, "width": 480, "height": 320}
    assert full.get_attribute("aria-label") == "Exit full window"
    page.keyboard.press("Escape")
    box = page.locator("splat-reel").bounding_box()
    assert box is not None
    assert box["width"] == 300


def test_what_a_reel_says_of_itself_is_text(page: Page, server: Server):
    say(page)
    open_player(page, server)
    assert page.title() == WORDS["title"]
    dialog = choose(page, "About this reel")
    assert dialog.get_attribute("aria-label") == WORDS["title"]
    assert dialog.locator("p").all_inner_texts() == ["By Ada", "On <i>its</i> round", "License: CC BY 4.0"]
    assert dialog.locator("b, i").count() == 0
    page.mouse.click(20, 20)  # outside
    assert dialog.is_hidden()


def test_a_picture_is_saved_in_all_pixels_and_playing_goes_on(plain: Page, server: Server):
    say(plain)
    open_player(plain, server)
    plain.evaluate(f"{PLAYER}.playbackRate = 0; {PLAYER}.currentTime = 0.2; {PLAYER}.play()")
    plain.wait_for_function(f"!{PLAYER}.seeking")
    with plain.expect_download() as waiting:
        plain.keyboard.press("p")
    assert waiting.value.suggested_filename == "a-b-toy-b-train-0.20s.png"
    saved = Image.open(waiting.value.path())
    assert (saved.size, saved.format) == ((960, 800), "PNG")
    small = np.asarray(saved.convert("RGB").resize((480, 400))).astype(float)
    shown = np.asarray(Image.open(io.BytesIO(plain.screenshot())).convert("RGB").resize((480, 400))).astype(float)
    assert small.mean() > 5
    assert np.abs(small - shown)[:250].mean() < 3  # above the controls
    assert plain.evaluate(f"{PLAYER}.paused") is False


def test_no_picture_before_there_is_one(page: Page, server: Server):
    page.route("**/groups/*", lambda route: None)
    page.goto(server.url)
    page.wait_for_function(f"{REEL}?.player?.manifest")
    page.keyboard.press("p")
    page.locator("splat-reel").get_by_text("The picture is not ready yet.").wait_for()
