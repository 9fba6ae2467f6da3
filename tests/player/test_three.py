"""@splatreel/three in a real Chromium: the element's picture, depth against meshes, transforms, rays, and freed memory."""

import shutil
from collections.abc import Iterator

import numpy as np
import pytest
from playwright.sync_api import Page

from splatreel.play.timeline import open_reel
from tests.golden import PREDICTIVE
from tests.player.engines import (
    GREEN,
    expect_errors_as_events,
    expect_meshes_to_hide_splats,
    expect_time_to_end,
    open_reel_in,
    pixels_of,
    write_site,
)
from tests.player.hosts import host
from tests.player.test_browser import psnr

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a folder with the page, the built package, three.js and a reel."""
    folder = tmp_path_factory.mktemp("three")
    shutil.copytree(write_site(folder, "three", "reel-object"), folder / "three")
    with host(folder) as address:
        yield address


@pytest.fixture
def opened(page: Page, site: str) -> Page:
    return open_reel_in(page, site)


def test_pictures_are_those_of_the_element(opened: Page) -> None:
    """The element's pictures equal those of Python (test_predictive_reel.py). The golden reel cross-fades from 0.2 to 0.267 s."""
    timeline = open_reel(PREDICTIVE)
    for seconds, least in ((0.05, 40), (0.31, 40), (0.225, 30)):
        found = pixels_of(opened, f"picture(reel, {seconds})")
        camera = timeline.manifest.camera
        want = np.clip(timeline.render(timeline.at(seconds), camera), 0, 1)
        assert want.std() > 0.05
        assert psnr(found, want) >= least, seconds
    assert opened.evaluate("events")[:2] == ["loadedmetadata", "canplay"]


def test_moved_scaled_and_turned_reels_look_the_same(opened: Page) -> None:
    before = pixels_of(opened, "picture(reel, 0.05)")
    opened.evaluate("reel.position.set(3, -2, 5), reel.rotation.set(0.4, 1.1, -0.3), reel.scale.setScalar(2.5)")
    after = pixels_of(opened, "(reel.viewFromStart(camera), pixels())")
    assert np.abs(after - before).max() < 0.05
    assert pixels_of(opened, "(reel.visible = false, pixels())").max() == 0


@pytest.mark.parametrize("query", ["", "?reversed"])
def test_meshes_hide_splats_behind_them_only(page: Page, site: str, query: str) -> None:
    open_reel_in(page, site + query)
    expect_meshes_to_hide_splats(page)


def test_splats_that_write_depth_hide_what_is_drawn_later(opened: Page) -> None:
    pixels_of(opened, "picture(reel, 0.05)")
    later = pixels_of(opened, "(addPlane({ transparent: true })(20), pixels())")
    assert np.abs(later - GREEN).max() < 0.01
    hidden = pixels_of(opened, "(reel.depthWrite = true, pixels())")
    assert (np.abs(hidden - GREEN).max(-1) > 0.05).mean() > 0.05


def test_rays_meet_splats(opened: Page) -> None:
    hits = opened.evaluate(
        """async () => {
          await picture(reel, 0.05);
          const ray = new THREE.Raycaster();
          const hit = (x, y) => (ray.setFromCamera(new THREE.Vector2(x, y), camera), ray.intersectObject(reel)[0]?.distance ?? null);
          const before = hit(0, 0);
          reel.scale.setScalar(2);
          reel.viewFromStart(camera);
          await pixels();
          const twice = hit(0, 0);
          camera.lookAt(camera.position.clone().multiplyScalar(2));
          camera.updateMatrixWorld();
          return [before, twice, hit(0, 0)];
        }"""
    )
    assert 2 < hits[0] < 6
    assert abs(hits[1] - 2 * hits[0]) < 0.05 * hits[0]
    assert hits[2] is None


def test_time_passes_and_ends(opened: Page) -> None:
    expect_time_to_end(opened)


def test_dispose_frees_all(opened: Page) -> None:
    counts = opened.evaluate(
        """async () => {
          reel.dispose();  // it may still upload groups
          scene.remove(reel);
          const gl = renderer.getContext();
          const held = new Set();
          for (const kind of ["Texture", "Buffer", "Framebuffer", "VertexArray", "Program"]) {
            const [make, free] = [gl[`create${kind}`].bind(gl), gl[`delete${kind}`].bind(gl)];
            gl[`create${kind}`] = () => { const made = make(); held.add(made); return made; };
            gl[`delete${kind}`] = (made) => { held.delete(made); free(made); };
          }
          const terminated = [];
          const terminate = Worker.prototype.terminate;
          Worker.prototype.terminate = function () { terminated.push(this); terminate.call(this); };
          const other = await openReel("reel/manifest.json", { loop: true, autoplay: true });
          const during = held.size;
          other.dispose();
          scene.remove(other);
          return [during, held.size, terminated.length, (await pixels()).length];
        }"""
    )
    assert counts[0] > 10
    assert counts[1] <= 3  # those of three.js for the material and the empty geometry
    assert counts[2] >= 2


def test_errors_are_events(page: Page, site: str) -> None:
    expect_errors_as_events(page, site)
