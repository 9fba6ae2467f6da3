"""Display while a reel loads: the poster, the layers and the progress, never a black canvas."""

import hashlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, Route

from splatreel.play.server import Server, serve
from splatreel.play.timeline import open_reel
from tests.golden import GOLDEN
from tests.player.pages import PLAYER, open_player, wait_for_picture
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
    for _ in range(1200):
        if np.abs(center(page) - color).max() < 12:
            return
        page.wait_for_timeout(50)
    raise AssertionError(center(page))


def test_the_page_shows_the_poster_before_the_player_is_there(postered: Page, server: Server):
    page = postered
    held: list[Route] = []
    page.route("**/player.js", lambda route: held.append(route))
    page.goto(server.url + "?autoplay=0")
    wait_for_color(page, RED)
    while not held:
        page.wait_for_timeout(20)
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
    assert page.evaluate(f"{POSTER}.hidden")


def test_the_posters_place_is_taken_by_what_rests_before_a_group_is_there(postered: Page, server: Server):
    page = postered
    page.route("**/groups/*", lambda route: None)  # never answered
    page.goto(server.url)
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.playback.hasPicture")
    assert page.evaluate(f"[{POSTER}.hidden, {PLAYER}.canPlay, {PLAYER}.playback.isMostlyStatic]") == [
        True,
        False,
        True,
    ]


def test_the_poster_of_the_page_goes_before_the_reels(postered: Page, server: Server):
    page = postered
    blue = jpeg((20, 40, 210))
    page.route("**/mine.jpg", lambda route: route.fulfill(body=blue, content_type="image/jpeg"))
    page.route("**/layers/*", lambda route: None)
    page.goto(server.url + "?poster=mine.jpg")
    wait_for_color(page, (20, 40, 210))
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.manifest")
    page.wait_for_timeout(100)
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
    page.wait_for_timeout(500)
    assert asked == ["layers/0000.safetensors"]
    assert page.evaluate(f"{PLAYER}.progress") == 0
    held.pop().continue_()
    while len(asked) < 2:
        page.wait_for_timeout(20)
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
        while not held:
            page.wait_for_timeout(20)
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
    page.wait_for_timeout(200)
    assert center(page).tolist() == list(ground)
    page.close()


def test_workers_start_when_they_are_wanted(page: Page, server: Server):
    page.add_init_script(
        "window.started = []; window.Worker = class extends Worker { constructor(url) { super(url); started.push(String(url)); } };"
    )
    page.route("**/layers/*", lambda route: None)
    page.goto(server.url)
    page.wait_for_function(f"document.querySelector('splat-reel')?.player && {PLAYER}.manifest")
    page.wait_for_timeout(200)
    names = sorted(url.split("/")[-1] for url in page.evaluate("started"))
    assert names == ["decode-worker.js", "sort-worker.js"]
    page.unroute("**/layers/*")
    open_player(page, server)
    assert page.evaluate("started.length") <= 3
