"""Measures of a scene."""

import numpy as np
import pytest

from splatreel.recon.init.layout import MAX_CLEAR_SHARE, Layout, border_color, clearance_of, measure
from tests.recon.scenes import look_at, ring

CAMERAS = ring(7, width=96, height=64)
BALL = np.random.default_rng(0).normal(size=(4000, 3)) * 0.2


def test_layout_dict_round_trip() -> None:
    layout = measure(CAMERAS, BALL, 0.1)
    assert Layout.from_dict(layout.to_dict()) == layout
    before = {name: value for name, value in layout.to_dict().items() if name != "clearance"}
    assert Layout.from_dict(before).clearance.share == 0, "of a run that began without one"


def test_clearance_focus_and_share() -> None:
    clearance = clearance_of(CAMERAS, BALL)
    np.testing.assert_allclose(clearance.focus, 0, atol=0.3)
    assert clearance.share == MAX_CLEAR_SHARE


@pytest.mark.parametrize("depth", [1.2, 0.4])
def test_clearance_never_hides_content_near_a_camera(depth: float) -> None:
    """A post takes a hundredth of the points of one of seven cameras, or a little more."""
    camera = CAMERAS[3]
    post = camera.center + depth * camera.viewmat[2, :3] + np.random.default_rng(1).normal(size=(60, 3)) * 0.02
    clearance = clearance_of(CAMERAS, np.concatenate([BALL, post]))
    assert 0.5 * depth < clearance.depth(camera) < depth
    assert not clearance.hides(post, camera).any()


def test_border_color_is_mean_near_borders() -> None:
    images = np.full((2, 80, 160, 3), 200, np.uint8)
    images[0, 10:70, 20:140] = 0
    images[1, 10:70, 20:140] = 255
    images[1, :10] = (100, 0, 200)
    images[1, 70:] = (100, 0, 200)
    red, green, blue = border_color(images)
    assert blue == pytest.approx(200 / 255, abs=1e-4)
    assert 100 / 255 < red < 200 / 255
    assert 0 < green < red


def test_clearance_without_points_is_zero() -> None:
    away = [look_at([0, 0, -4 - i], target=(0, 0, -9)) for i in range(3)]
    assert clearance_of(away, BALL).share == 0
