"""The local viewer: a real viser server, and a browser that looks at it."""

import io
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.kernels.image import render_image
from splatreel.play.renderers import renderer
from splatreel.play.timeline import open_reel
from splatreel.play.viewer import Viewer, camera_of, place_camera
from splatreel.scene.camera import Camera
from tests.golden import GOLDEN
from tests.player.conftest import browser  # noqa: F401 - the fixture


class Handle:
    """A camera of viser: a place, what it looks at, a vertical field of view."""

    position: np.ndarray
    look_at: np.ndarray
    fov: float


def test_a_camera_comes_back_as_it_was_placed() -> None:
    viewmat = np.eye(4)
    viewmat[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    viewmat[:3, 3] = (0.2, -0.3, 4)
    K = np.array([[90, 0, 60], [0, 90, 40], [0, 0, 1]])
    given = Camera("given", viewmat, K, 120, 80)
    handle = Handle()
    place_camera(handle, given, np.zeros(3))
    assert np.allclose(handle.position, given.center, atol=1e-6)
    ahead = handle.look_at - handle.position
    assert np.allclose(ahead / np.linalg.norm(ahead), given.forward, atol=1e-6)
    assert np.linalg.norm(ahead) == pytest.approx(4)
    back = camera_of(handle.position, np.array([0.5, -0.5, -0.5, -0.5]), handle.fov, 120, 80)
    assert np.allclose(back.viewmat, given.viewmat, atol=1e-6)
    assert np.allclose(back.K, given.K, atol=1e-4)


def test_unknown_places_still_have_something_ahead() -> None:
    handle = Handle()
    camera = Camera("away", np.eye(4), np.diag([50.0, 50, 1]), 100, 100)
    place_camera(handle, camera, np.array([0.0, 0, -2]))  # the middle lies behind
    assert np.allclose(handle.look_at, [0, 0, 2])
    assert handle.fov == pytest.approx(2 * math.atan(1))


@pytest.mark.browser
def test_a_browser_sees_what_the_kernels_draw(browser, tmp_path: Path) -> None:  # noqa: F811
    pytest.importorskip("viser", reason="the local viewer's test needs splatreel[viewer]")
    reel = open_reel(GOLDEN)
    with Viewer(reel, renderer("cpu")) as viewer:
        page = browser.new_page(viewport={"width": 640, "height": 480})
        page.goto(viewer.url)
        page.get_by_role("button", name="Pause").click()
        field = page.get_by_role("textbox").first
        field.fill("0.3")
        field.press("Enter")
        for _ in range(100):
            if viewer.clock.time == pytest.approx(0.3) and viewer.settled:
                break
            page.wait_for_timeout(100)
        page.wait_for_timeout(500)  # the last picture is on its way
        shot = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB")) / 255
        page.get_by_role("button", name="Play").click()
        page.wait_for_timeout(300)
        playing = viewer.clock.playing
        page.close()
    assert playing
    want = np.clip(render_image(reel.at(0.3), reel.manifest.camera.resized(640, 480)), 0, 1)
    below = slice(240, None)  # the panel and a warning cover what is above
    error = np.mean((shot[below] - want[below]) ** 2)
    assert want[below].std() > 0.05
    assert -10 * np.log10(error) > 30
