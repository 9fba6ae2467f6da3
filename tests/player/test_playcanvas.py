"""@splatreel/playcanvas in a real Chromium: pictures like Python's, depth against meshes, transforms, and freed memory."""

import shutil
from collections.abc import Iterator

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.play.timeline import open_reel
from tests.golden import PREDICTIVE
from tests.player.engines import (
    expect_errors_as_events,
    expect_meshes_to_hide_splats,
    expect_snippet_to_draw,
    expect_time_to_end,
    open_reel_in,
    pixels_of,
    write_site,
)
from tests.player.hosts import host
from tests.player.test_browser import psnr
from tests.player.test_three import PROMISES, expect_promises

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a folder with the page, the built package, the engine and a reel."""
    folder = tmp_path_factory.mktemp("playcanvas")
    engine = write_site(folder, "playcanvas", "reel-script")
    (folder / "playcanvas").mkdir()
    shutil.copy(engine / "playcanvas.mjs", folder / "playcanvas")
    with host(folder) as address:
        yield address


@pytest.fixture
def opened(page: Page, site: str) -> Page:
    return open_reel_in(page, site)


def test_pictures_are_those_of_python(opened: Page) -> None:
    """PlayCanvas ends splats at eight variances and packs them, so that pictures differ more than the element's."""
    timeline = open_reel(PREDICTIVE)
    camera = timeline.manifest.camera
    for seconds, least in ((0.05, 38), (0.31, 38), (0.225, 30)):  # the last in a cross-fade
        found = pixels_of(opened, f"picture(reel, {seconds})")
        want = np.clip(timeline.render(timeline.at(seconds), camera), 0, 1)
        assert want.std() > 0.05
        assert psnr(found, want) >= least, seconds
    other = np.clip(timeline.render(timeline.at(0.31), camera), 0, 1)
    assert psnr(pixels_of(opened, "picture(reel, 0.05)"), other) < 30, "a seek goes to another picture"
    assert opened.evaluate("events")[:2] == ["loadedmetadata", "canplay"]


def test_moved_scaled_and_turned_reels_look_the_same(opened: Page) -> None:
    before = pixels_of(opened, "picture(reel, 0.05)")
    opened.evaluate(
        """() => {
          reel.entity.setPosition(3, -2, 5);
          reel.entity.setEulerAngles(23, 63, -17);
          reel.entity.setLocalScale(2.5, 2.5, 2.5);
          reel.viewFromStart(camera);
        }"""
    )
    after = pixels_of(opened, "pixels()")
    assert psnr(after, before) > 38
    assert pixels_of(opened, "(reel.entity.enabled = false, pixels())").max() == 0
    assert np.abs(pixels_of(opened, "(reel.entity.enabled = true, pixels())") - after).max() < 0.02


def test_meshes_hide_splats_behind_them_only(opened: Page) -> None:
    expect_meshes_to_hide_splats(opened)


def test_the_snippet_of_the_docs_shows_the_reel(page: Page, site: str) -> None:
    expect_snippet_to_draw(page, site, "playcanvas")


def test_opacity_fades_the_reel(opened: Page) -> None:
    full = pixels_of(opened, "picture(reel, 0.05)")
    half = pixels_of(opened, "(reel.opacity = 0.5, pixels())")
    assert 0.3 < half.mean() / full.mean() < 0.9


def test_time_passes_and_ends(opened: Page) -> None:
    expect_time_to_end(opened)


def test_destroy_frees_all(opened: Page) -> None:
    counts = opened.evaluate(
        """async () => {
          reel.entity.destroy();
          for (let i = 0; i < 10; i++) await frame();
          const held = new Set();
          for (const kind of ["Texture", "Buffer", "Framebuffer", "VertexArray"]) {
            const [make, free] = [gl[`create${kind}`].bind(gl), gl[`delete${kind}`].bind(gl)];
            gl[`create${kind}`] = () => { const made = make(); held.add(made); return made; };
            gl[`delete${kind}`] = (made) => { held.delete(made); free(made); };
          }
          const terminated = [];
          const terminate = Worker.prototype.terminate;
          Worker.prototype.terminate = function () { terminated.push(this); terminate.call(this); };
          const other = await openReel("reel/manifest.json", { loop: true, autoplay: true });
          await frame();
          const during = held.size;
          other.entity.destroy();
          for (let i = 0; i < 10; i++) await frame();
          const nodes = app.root.find((node) => node.name === "reel file" || node.name === "splats").length;
          return [during, held.size, terminated.length, nodes, (await pixels()).length];
        }"""
    )
    assert counts[0] > 10
    assert counts[1] <= counts[0] / 2
    assert counts[2] >= 1
    assert counts[3] == 0


def test_errors_are_events(page: Page, site: str) -> None:
    expect_errors_as_events(page, site)


def test_playing_is_a_promise_and_a_destroyed_reel_is_never_ready(opened: Page) -> None:
    expect_promises(opened.evaluate(f"({PROMISES})(reel, () => reel.entity.destroy())"))
