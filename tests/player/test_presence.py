"""Many reels on a page: hidden reels hold no memory, visible ones play, and moving an element changes nothing."""

import io

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Locator, Page

from splatreel.play.player_page import STATIC
from tests.golden import PREDICTIVE
from tests.player.hosts import host
from tests.player.pages import let_frames_pass

pytestmark = pytest.mark.browser

COUNTED = """<!doctype html><link rel="icon" href="data:," /><body style="margin: 0">
<script type="module" src="player/player.js"></script>
<script>
  window.workers = 0;
  window.Worker = class extends Worker {
    constructor(url) { super(url); workers++; }
    terminate() { workers--; super.terminate(); }
  };
  const canvases = new Set();
  const context = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    if (kind === "webgl2") canvases.add(this);
    return context.call(this, kind, options);
  };
  window.devices = () => [...canvases].filter((canvas) => !context.call(canvas, "webgl2").isContextLost()).length;
  window.reels = () => [...document.querySelectorAll("splat-reel")];
</script>"""
"""Counts running workers, and graphics devices that are held."""


def reels(count: int, style: str) -> str:
    return COUNTED + f'<splat-reel src="reel/manifest.json" style="{style}"></splat-reel>' * count


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("site")
    (folder / "player").symlink_to(STATIC)
    (folder / "reel").symlink_to(PREDICTIVE)
    pages = {
        "/column": reels(20, "width: 200px; height: 150px; margin-bottom: 150px"),
        "/grid": reels(20, "width: 80px; height: 60px; float: left"),
        "/one": reels(1, "width: 200px; height: 150px") + '<p style="height: 3000px"></p><div id="other"></div>',
    }
    with host(folder, pages) as url:
        yield url


def variation(element: Locator) -> float:
    """Return the standard deviation of the colors in an element's screenshot."""
    return float(np.asarray(Image.open(io.BytesIO(element.screenshot())).convert("RGB"), float).std())


def test_of_twenty_in_a_column_only_those_near_hold_anything(page: Page, site: str):
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url) if request.url.endswith("manifest.json") else None)
    page.goto(site + "column")
    page.wait_for_function("reels()[0].readyState === 4")
    let_frames_pass(page, 30)
    assert len(asked) <= 2, "of 320 pixels of height and three quarters beyond"
    assert page.evaluate("[devices(), workers]") <= [2, 6]
    states = page.evaluate("reels().map((r) => [r.networkState, r.readyState])")
    assert states[5:] == [[1, 0]] * 15
    for index in (6, 13, 19):
        page.evaluate(f"reels()[{index}].scrollIntoView()")
        page.wait_for_function(f"reels()[{index}].readyState === 4")
    assert variation(page.locator("splat-reel").nth(19)) > 5
    # Those that have gone far away give all back.
    page.wait_for_function("devices() <= 3 && workers <= 9")
    assert page.evaluate("reels()[0].player.session") is None
    assert page.evaluate("reels()[0].duration") > 0, "what is known of the reel stays known"


def test_twenty_on_the_screen_all_show_their_picture(page: Page, site: str):
    page.goto(site + "grid")
    page.wait_for_function("reels().every((r) => r.readyState === 4 || r.shadowRoot.querySelector('.still'))")
    assert page.evaluate("devices()") <= 12
    assert page.evaluate("reels().every((r) => r.error === null)")
    elements = page.locator("splat-reel")
    assert all(variation(elements.nth(index)) > 5 for index in range(20))
    resting = page.evaluate("reels().findIndex((r) => r.player.session === null)")
    elements.nth(resting).click()
    page.evaluate(f"reels()[{resting}].play()")
    page.wait_for_function(f"reels()[{resting}].currentTime > 0")
    assert page.evaluate("devices()") <= 12


def test_one_that_comes_back_has_its_time_and_view(page: Page, site: str):
    page.goto(site + "one")
    page.wait_for_function("reels()[0].readyState === 4")
    view = [1, 0, 0, 0.25, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1]
    page.evaluate("(viewmat) => { const [r] = reels(); r.loop = true; r.camera = {viewmat}; return r.play(); }", view)
    page.evaluate("scrollTo(0, 2500)")
    page.wait_for_function("!reels()[0].shadowRoot.querySelector('.still') && !reels()[0].player.playback.advancing")
    time = page.evaluate("reels()[0].currentTime")
    let_frames_pass(page)
    assert page.evaluate("reels()[0].currentTime") == time, "time stands still where nobody looks"
    page.wait_for_function("devices() === 0 && workers === 0")
    page.evaluate("reels()[0].pause(); scrollTo(0, 0)")
    let_frames_pass(page, 2)
    assert variation(page.locator("splat-reel")) > 5, "its last picture is there until it draws again"
    page.wait_for_function("reels()[0].readyState === 4 && !reels()[0].shadowRoot.querySelector('.still')")
    assert page.evaluate("reels()[0].currentTime") == time
    assert page.evaluate("reels()[0].camera.viewmat") == pytest.approx(view)
    assert variation(page.locator("splat-reel")) > 5


def test_moving_an_element_changes_nothing_and_taking_it_out_pauses(page: Page, site: str):
    page.goto(site + "one")
    page.wait_for_function("reels()[0].readyState === 4")
    page.evaluate("reels()[0].currentTime = 0.2")
    page.wait_for_function("!reels()[0].seeking")
    page.evaluate("""() => {
      const [r] = reels();
      window.session = r.player.session;
      r.addEventListener('emptied', () => (window.emptied = true));
      document.body.prepend(document.querySelector('#other'));
      document.querySelector('#other').append(r);
    }""")
    let_frames_pass(page)
    assert page.evaluate("[reels()[0].player.session === session, reels()[0].currentTime, window.emptied]") == [
        True,
        0.2,
        None,
    ]
    page.evaluate("window.r = reels()[0]; r.play().then(() => r.remove())")
    page.wait_for_function("r.paused && devices() === 0 && workers === 0")
    time = page.evaluate("r.currentTime")
    assert time >= 0.2
    page.evaluate("document.body.prepend(r)")
    page.wait_for_function("r.readyState === 4")
    assert page.evaluate("[r.currentTime, r.paused, window.emptied]") == [time, True, None]


def test_an_eager_one_loads_wherever_it_is_and_a_picture_can_be_taken_of_any(page: Page, site: str):
    page.goto(site + "one")
    page.evaluate("""() => {
      scrollTo(0, 0);
      for (const loading of ['eager', 'lazy']) {
        const r = document.createElement('splat-reel');
        Object.assign(r, { loading, src: 'reel/manifest.json', id: loading });
        document.body.append(r);
      }
    }""")
    page.wait_for_function("document.querySelector('#eager').readyState >= 1")
    let_frames_pass(page)
    assert page.evaluate("document.querySelector('#lazy').readyState") == 0
    taken = page.evaluate("""async () => {
      const manifest = document.querySelector('#eager').player.manifest;
      const picture = await document.querySelector('#lazy').renderAt(0.1, manifest.camera, 160, 120);
      return new Set(picture.data).size;
    }""")
    assert taken > 10
