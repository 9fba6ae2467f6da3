"""Display while a reel loads: the poster, the layers and the progress, never a black canvas."""

import hashlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, Route

from splatreel.play.player_page import STATIC
from splatreel.play.server import Server, serve
from splatreel.play.timeline import open_reel
from tests.golden import GOLDEN
from tests.player.pages import (
    PLAYER,
    expect_problems,
    let_frames_pass,
    let_time_pass,
    open_player,
    wait_for_picture,
    wait_until,
)
from tests.player.test_browser import picture, psnr

pytestmark = pytest.mark.browser

PARTS = Path(__file__).parents[2] / "conformance" / "parts"
RED = (200, 30, 40)
POSTER = "document.querySelector('splat-reel').shadowRoot.querySelector('img.poster')"


def jpeg(color: tuple[int, int, int]) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (32, 24), color).save(out, "JPEG", quality=95)
    return out.getvalue()


@pytest.fixture
def postered(page: Page) -> Page:
    """Add a red poster to the reel."""
    data = jpeg(RED)
    poster = {
        "uri": "poster.jpg",
        "bytes": len(data),
        "sha256": hashlib.sha256(data).hexdigest(),
        "width": 32,
        "height": 24,
    }
    manifest = json.loads((GOLDEN / "manifest.json").read_text()) | {"poster": poster}
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))
    page.route("**/reel/poster.jpg", lambda route: route.fulfill(body=data, content_type="image/jpeg"))
    return page


def center(page: Page) -> np.ndarray:
    """Return the color in the middle of the window, a little above the spinner."""
    picture = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), int)
    return picture[picture.shape[0] // 4, picture.shape[1] // 2]


def wait_for_color(page: Page, color: tuple[int, int, int]) -> None:
    wait_until(page, lambda: np.abs(center(page) - color).max() < 12)


def test_the_page_shows_the_poster_before_the_player_is_there(postered: Page, server: Server):
    page = postered
    held: list[Route] = []
    page.route("**/player.js", lambda route: held.append(route))
    page.goto(server.url + "?autoplay=0")
    wait_for_color(page, RED)
    wait_until(page, lambda: held)
    page.unroute("**/player.js")
    layers: list[Route] = []
    page.route("**/layers/*", lambda route: layers.append(route))
    for route in held:
        route.continue_()
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.manifest")
    wait_for_color(page, RED)
    assert page.evaluate("document.querySelectorAll('main > img').length") == 0, "the element shows it now"
    page.unroute("**/layers/*")
    for route in layers:
        route.continue_()
    wait_for_picture(page)
    page.wait_for_function(f"{POSTER}.hidden")


def hold_groups(page: Page) -> list[Route]:
    """Answer no request for a group."""
    held: list[Route] = []
    page.route("**/groups/*", lambda route: held.append(route))
    return held


def wait_for_first_part(page: Page) -> None:
    """Wait until something is drawn, and some display frames more."""
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.playback.hasPicture")
    page.evaluate("new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))")
    assert page.evaluate(f"[{PLAYER}.canPlay, {PLAYER}.playback.isMostlyStatic]") == [False, True]


def test_the_poster_stays_until_the_frame_is_complete_and_fades_out(postered: Page, server: Server):
    page = postered
    page.add_init_script(
        "window.fades = []; const { animate } = Element.prototype; Element.prototype.animate = function (frames, options) {"
        " if (this.className === 'poster') fades.push([frames, options]); return animate.call(this, frames, options); };"
    )
    held = hold_groups(page)
    page.goto(server.url + "?autoplay=0")
    wait_for_first_part(page)
    assert page.evaluate(f"[{POSTER}.hidden, fades]") == [False, []]
    wait_for_color(page, RED)
    page.locator("splat-reel .wait.long").wait_for()
    page.unroute("**/groups/*")
    for route in held:
        route.continue_()
    wait_for_picture(page)
    page.wait_for_function(f"{POSTER}.hidden")
    assert page.evaluate("fades") == [[{"opacity": 0}, 350]]


def test_a_hand_that_moves_the_camera_removes_the_poster(postered: Page, server: Server):
    page = postered
    hold_groups(page)
    page.goto(server.url + "?autoplay=0")
    wait_for_first_part(page)
    page.mouse.move(100, 100)
    page.mouse.down()
    page.mouse.move(140, 110, steps=4)
    page.wait_for_function(f"{POSTER}.hidden")
    assert page.evaluate(f"{PLAYER}.canPlay") is False


def test_the_poster_of_the_start_leaves_a_link_to_another_time(postered: Page, server: Server):
    page = postered
    hold_groups(page)
    page.goto(server.url + "?autoplay=0#t=0.1")
    wait_for_first_part(page)
    page.wait_for_function(f"{POSTER}.hidden")
    assert page.evaluate(f"{PLAYER}.canPlay") is False


def test_the_poster_lies_as_the_first_view_of_a_narrow_window_does(postered: Page, server: Server):
    page = postered
    page.set_viewport_size({"width": 320, "height": 480})
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    manifest["poster"] = {"uri": "poster.jpg", "bytes": 900, "sha256": "0" * 64, "width": 32, "height": 24}
    manifest["limits"] = {"focus": [1, 0.3, 0]}
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))
    page.route("**/layers/*", lambda route: None)
    page.goto(server.url)
    page.wait_for_function(f"document.querySelector('splat-reel')?.player?.manifest && {POSTER}.src")
    # The focus is at column 110 of 160. The image is 640 pixels wide in a window of 320, whose middle is 160.
    assert page.evaluate(f"{POSTER}.style.objectPosition") == f"{100 * (640 * 110 / 160 - 160) / 320}% 50%"


def test_the_page_shows_that_it_loads_before_the_player_is_there(page: Page, server: Server):
    held: list[Route] = []
    page.route("**/player.js", lambda route: held.append(route))
    page.goto(server.url + "?autoplay=0")
    page.wait_for_function("document.querySelector('main > div')?.getAnimations({subtree: true}).length === 1")
    wait_until(page, lambda: held)
    held.pop().continue_()
    page.unroute("**/player.js")
    wait_for_picture(page)
    page.wait_for_function("document.querySelector('main > div') === null")


def test_a_page_whose_player_does_not_arrive_says_so(page: Page, server: Server):
    expect_problems(page, "ERR_FAILED")
    page.route("**/player.js", lambda route: route.abort())
    page.goto(server.url)
    page.get_by_role("alert").get_by_text("player.js does not arrive").wait_for()
    let_time_pass(page, 600)  # past the time at which the spinner shows
    assert page.evaluate("document.getAnimations().length") == 0


def test_a_page_whose_player_is_late_says_so_until_it_comes(page: Page, server: Server):
    held: list[Route] = []
    page.clock.install()
    page.route("**/player.js", lambda route: held.append(route))
    page.goto(server.url + "?autoplay=0")
    page.clock.fast_forward(30_000)
    page.get_by_role("alert").get_by_text("has not arrived yet").wait_for()
    wait_until(page, lambda: held)
    held.pop().continue_()
    page.unroute("**/player.js")
    page.clock.resume()
    page.wait_for_function("document.querySelector('main > splat-reel') && !document.querySelector('main > div')")


def test_a_page_from_a_disk_says_how_to_open_the_reel(page: Page):
    expect_problems(page, "file:", "ERR_FAILED", "CORS")
    page.goto((STATIC / "index.html").as_uri())
    page.get_by_role("alert").get_by_text("splatreel view REEL").wait_for()


@pytest.mark.parametrize(
    "uri", ["http://other.example/x", "//other.example/x", "\\\\other.example/x", "https:other.example", "../x", "/x"]
)
def test_a_manifest_makes_the_page_ask_no_address_outside_of_the_reel(page: Page, server: Server, uri: str):
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    manifest["poster"] = {"uri": uri, "bytes": 1000, "sha256": "0" * 64, "width": 32, "height": 24}
    manifest["layers"][0]["uri"] = manifest["groups"][0]["uri"] = uri
    page.route("**/reel/manifest.json", lambda route: route.fulfill(json=manifest))
    page.goto(server.url)
    page.locator("splat-reel").get_by_role("alert").wait_for()
    others = [url for url in asked if not url.startswith(server.url) and not url.startswith("data:")]
    others += [url for url in asked if url == f"{server.url}x"]
    assert others == []


def test_the_poster_of_the_page_goes_before_the_reels(postered: Page, server: Server):
    page = postered
    blue = jpeg((20, 40, 210))
    page.route("**/mine.jpg", lambda route: route.fulfill(body=blue, content_type="image/jpeg"))
    page.route("**/layers/*", lambda route: None)
    page.goto(server.url + "?poster=mine.jpg")
    wait_for_color(page, (20, 40, 210))
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.manifest")
    let_frames_pass(page)
    wait_for_color(page, (20, 40, 210))


def test_layers_have_the_line_before_groups_and_a_percentage_is_told(page: Page, server: Server):
    asked: list[str] = []
    held: list[Route] = []

    def hold(route: Route) -> None:
        asked.append(route.request.url.split("/reel/")[1])
        held.append(route)

    page.route("**/layers/*", hold)
    page.route("**/groups/*", hold)
    page.goto(server.url + "?autoplay=0")
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.manifest")
    wait_until(page, lambda: asked)
    let_frames_pass(page, 30)
    assert asked == ["layers/0000.safetensors"]
    assert page.evaluate(f"{PLAYER}.progress") == 0
    held.pop().continue_()
    wait_until(page, lambda: len(asked) >= 2)
    assert asked[1] == "groups/0000.safetensors"
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    layer, group = (manifest[kind][0]["bytes"] for kind in ("layers", "groups"))
    page.wait_for_function(f"Math.abs({PLAYER}.progress - {layer / (layer + group)}) < 1e-6")
    assert page.locator("splat-reel .wait").text_content() == f"Loading {100 * layer // (layer + group)} %"
    held.pop().continue_()
    page.unroute("**/groups/*")
    page.unroute("**/layers/*")
    wait_for_picture(page)
    assert page.evaluate(f"{PLAYER}.progress") == 1


def test_the_first_part_of_a_layer_is_drawn_alone(page: Page):
    """The other part never arrives, until it does. The picture is then the one that Python draws."""
    held: list[Route] = []
    page.route("**/layers/0000.1.safetensors", lambda route: held.append(route))
    reel = open_reel(PARTS)
    with serve(PARTS, port=0) as server:
        page.goto(server.url + "?autoplay=0")
        page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.playback.hasPicture")
        first, second = (layer.points for layer in reel.manifest.layers)
        assert 0 < page.evaluate(f"{PLAYER}.stage.points") <= first < second
        assert page.evaluate(f"[{PLAYER}.canPlay, {PLAYER}.busy, {PLAYER}.error]") == [False, True, None]
        wait_until(page, lambda: held)
        held.pop().continue_()
        wait_for_picture(page)
        for seconds in (0.05, 0.45):
            camera = reel.manifest.camera
            want = np.clip(reel.render(reel.at(seconds), camera), 0, 1)
            assert psnr(picture(page, seconds, camera), want) >= 45


@pytest.mark.parametrize(("scheme", "ground"), [("light", (241, 241, 243)), ("dark", (11, 11, 12))])
def test_the_ground_of_the_page_shows_before_the_first_picture(browser: Browser, server: Server, scheme, ground):
    page = browser.new_page(viewport={"width": 320, "height": 240}, color_scheme=scheme)
    page.route("**/layers/*", lambda route: None)
    page.goto(server.url)
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.manifest")
    let_frames_pass(page)
    assert center(page).tolist() == list(ground)
    page.close()


def test_workers_start_when_they_are_wanted(page: Page, server: Server):
    page.add_init_script(
        "window.started = []; window.Worker = class extends Worker { constructor(url) { super(url); started.push(String(url)); } };"
    )
    page.route("**/layers/*", lambda route: None)
    page.goto(server.url)
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.manifest")
    page.wait_for_function("started.length >= 2")
    let_frames_pass(page)
    names = sorted(url.split("/")[-1] for url in page.evaluate("started"))
    assert names == ["decode-worker.js", "sort-worker.js"]
    page.unroute("**/layers/*")
    open_player(page, server)
    assert page.evaluate("started.length") <= 3
