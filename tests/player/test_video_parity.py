"""Parity of <splat-reel> with <video>: fragments, preload, frame callbacks, error codes, played ranges."""

import json
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.play.server import Server, serve
from tests.golden import GOLDEN, PREDICTIVE
from tests.player.pages import PLAYER, expect_problems, let_frames_pass, let_time_pass, open_player
from tests.player.test_media_element import EMBED, opened

pytestmark = pytest.mark.browser


@pytest.fixture
def embed(page: Page, server: Server) -> Page:
    """Open a page with an element `r` without a reel, and `seen`, its events."""
    page.route("**/embed.html", lambda route: route.fulfill(content_type="text/html", body=EMBED))
    page.goto(server.url + "embed.html")
    page.wait_for_function("window.r")
    return page


def shot(page: Page) -> np.ndarray:
    """Take a screenshot of the element, [H, W, 3] of 0..1."""
    import io

    from PIL import Image

    data = page.locator("splat-reel").screenshot()
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")) / 255


def test_the_same_src_again_begins_anew(embed: Page):
    page = embed
    opened(page)
    page.evaluate("r.currentTime = 0.2; seen.length = 0; r.src = r.src")
    assert page.evaluate("[r.currentTime, r.readyState, seen[0]]") == [0, 0, "emptied"]
    page.wait_for_function("r.readyState === 4")


def test_a_time_that_is_set_before_the_element_is_in_a_page_holds(embed: Page):
    page = embed
    page.evaluate("""() => {
      const reel = (window.r = document.createElement("splat-reel"));
      reel.src = "reel/manifest.json";
      reel.currentTime = "0.2";
      window.early = reel.currentTime;
      document.body.replaceChildren(reel);
    }""")
    page.wait_for_function("r.readyState === 4")
    assert page.evaluate("[early, r.currentTime]") == [0.2, 0.2]


def test_numbers_may_be_written_out(embed: Page):
    page = embed
    opened(page)
    page.evaluate("r.currentTime = '0.1'; r.playbackRate = '0.5'; r.volume = '0.25'")
    assert page.evaluate("[r.currentTime, r.playbackRate, r.volume]") == [0.1, 0.5, 0.25]


def test_errors_have_the_codes_of_a_media_error(embed: Page):
    page = embed
    expect_problems(page, "404")
    page.evaluate("r.src = 'nowhere/manifest.json'")
    page.wait_for_function("r.error")
    assert page.evaluate("[r.error.code, r.error.message.includes('404')]") == [4, True]
    page.route("**/groups/0001*", lambda route: route.fulfill(status=404, body="gone"))
    opened_partly = "r.src = 'reel/manifest.json'"
    page.evaluate(opened_partly)
    page.wait_for_function("r.readyState >= 2")
    page.evaluate("r.currentTime = 0.3")
    page.wait_for_function("r.error")
    assert page.evaluate("r.error.code === MediaError.MEDIA_ERR_NETWORK")
    page.unroute("**/groups/0001*")
    page.route("**/groups/0001*", lambda route: route.fulfill(body="x" * 100))
    page.evaluate(opened_partly)
    page.wait_for_function("!r.error && r.readyState >= 2")
    page.evaluate("r.currentTime = 0.3")
    page.wait_for_function("r.error", timeout=60_000)
    assert page.evaluate("r.error.code") in (2, 3)


def test_times_of_the_address_say_where_to_begin_and_to_pause(embed: Page):
    page = embed
    page.evaluate("r.src = 'reel/manifest.json#t=0.1,0.2'")
    page.wait_for_function("r.readyState === 4")
    assert page.evaluate("[r.currentTime, r.currentSrc.endsWith('#t=0.1,0.2')]") == [0.1, True]
    page.evaluate("r.playbackRate = 0.5; r.play()")
    page.wait_for_function("seen.includes('play') && r.paused")
    assert 0.2 <= page.evaluate("r.currentTime") < 0.39
    page.evaluate("r.play()")  # and on from there
    page.wait_for_function("r.ended")


def test_what_was_played_and_fast_seeks(embed: Page):
    page = embed
    opened(page)
    assert page.evaluate("r.played.length") == 0
    page.evaluate("r.playbackRate = 0.5; r.play()")
    page.wait_for_function("r.currentTime > 0.05")
    page.evaluate("r.pause(); r.fastSeek(0.3)")
    page.wait_for_function("!r.seeking")
    assert page.evaluate("[r.played.length, r.played.start(0), r.currentTime]") == [1, 0, 0.3]
    assert 0.05 < page.evaluate("r.played.end(0)") < 0.3


def test_pages_hear_of_each_picture(embed: Page):
    page = embed
    opened(page)
    page.evaluate("""() => {
      window.frames_ = [];
      const next = (now, metadata) => {
        frames_.push(metadata);
        if (frames_.length < 5) r.requestVideoFrameCallback(next);
      };
      r.requestVideoFrameCallback(next);
      window.cancelled = 0;
      r.cancelVideoFrameCallback(r.requestVideoFrameCallback(() => cancelled++));
      r.loop = true;
      r.play();
    }""")
    page.wait_for_function("frames_.length === 5")
    let_frames_pass(page)
    seen = page.evaluate("frames_")
    assert len(seen) == 5
    assert page.evaluate("cancelled") == 0
    assert all(b["presentedFrames"] > a["presentedFrames"] for a, b in pairwise(seen))
    assert all(frame["width"] > 0 and 0 <= frame["mediaTime"] <= 0.4 for frame in seen)


def test_preload_none_gets_nothing_until_people_ask(embed: Page):
    page = embed
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.evaluate("r.controls = true; r.preload = 'none'; r.src = 'reel/manifest.json'")
    start = page.locator("splat-reel .start")
    start.wait_for()
    let_frames_pass(page)
    assert page.evaluate("[r.preload, r.networkState, r.readyState]") == ["none", 1, 0]
    assert [url for url in asked if "/reel/" in url] == []
    assert page.locator("splat-reel .wait").is_hidden()
    start.click()
    page.wait_for_function("seen.includes('playing')")


def test_preload_metadata_gets_the_manifest_only(embed: Page):
    page = embed
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.evaluate("r.controls = true; r.setAttribute('preload', 'metadata'); r.src = 'reel/manifest.json'")
    page.wait_for_function("r.duration > 0")
    page.locator("splat-reel .start").wait_for()
    let_frames_pass(page)
    assert [url.rsplit("/", 1)[1] for url in asked if "/reel/" in url] == ["manifest.json"]
    assert page.evaluate("[r.preload, r.readyState, r.networkState]") == ["metadata", 1, 1]
    page.evaluate("r.currentTime = 0.2")  # who asks for a time asks for a picture
    page.wait_for_function("r.readyState === 4 && !r.seeking")


def test_a_reel_that_is_replaced_on_its_host_is_opened_anew(page: Page, tmp_path: Path):
    reel = shutil.copytree(PREDICTIVE, tmp_path / "reel")
    with serve(reel, port=0) as server:
        open_player(page, server, "?autoplay=0&loop=0")
        # Another reel at the same address: only its manifest tells.
        shutil.rmtree(reel)
        shutil.copytree(GOLDEN, reel)
        page.evaluate(f"{PLAYER}.rest(); {PLAYER}.wake()")
        page.wait_for_function(f"{PLAYER}.canPlay && {PLAYER}.manifest.groups.length === {group_count(GOLDEN)}")
        assert page.evaluate(f"{PLAYER}.error") is None


def group_count(reel: Path) -> int:
    return len(json.loads((reel / "manifest.json").read_text())["groups"])


def test_the_last_picture_stays_when_the_graphics_device_is_lost(embed: Page):
    page = embed
    page.emulate_media(reduced_motion="reduce")
    opened(page)
    page.evaluate("r.currentTime = 0.1")
    page.wait_for_function("!r.seeking")
    let_time_pass(page, 600)  # a copy is taken 0.3 seconds after the last frame
    before = shot(page)
    page.evaluate("""() => {
      const gl = r.player.canvas.getContext("webgl2");
      window.device = gl.getExtension("WEBGL_lose_context");
      device.loseContext();
    }""")
    page.wait_for_function("r.error")
    after = shot(page)
    assert before.max() > 0.3
    assert np.abs(after - before).mean() < 0.02
    page.evaluate("device.restoreContext()")
    page.wait_for_function("!r.error && r.readyState === 4 && !r.shadowRoot.querySelector('.still')")


def test_the_focus_stays_in_a_dialog(page: Page, server: Server):
    open_player(page, server)
    reel = page.locator("splat-reel")
    inside = "(() => { const { activeElement } = document.querySelector('splat-reel').shadowRoot;"
    inside += " return activeElement?.closest('.dialog') !== null && activeElement?.className; })()"
    page.keyboard.press("?")
    reel.get_by_role("dialog").wait_for()
    for key in ("Tab", "Tab", "Shift+Tab"):
        page.keyboard.press(key)
        assert page.evaluate(inside) == "close"
    page.keyboard.press("Escape")
    reel.get_by_role("button", name="Settings").click()
    reel.locator(".menu").get_by_role("button", name="Share").click()
    reel.get_by_role("dialog", name="Share").wait_for()
    names = []
    for _ in range(10):
        names.append(page.evaluate(inside))
        page.keyboard.press("Tab")
    assert False not in names
    assert len(set(names)) > 1
    assert names.count("close") == 2, "once round"
    page.keyboard.press("Escape")
