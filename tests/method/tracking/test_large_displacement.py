"""Large displacements: a ball leaps farther than its size."""

import numpy as np

from splatreel.method.tracking.large_displacement import large_displacements
from splatreel.method.tracking.new_points import error_masks, find_new_points
from splatreel.scene.gaussians import Gaussians
from tests.method.tracking.test_new_points import (
    BACKGROUND,
    CAMERAS,
    CENTER,
    EMPTY,
    NEAR,
    NOTHING,
    PIXEL,
    RADIUS,
    ball,
    make_images,
    sure,
)

MOTION = np.array([0.5, 0.3, -0.2])


def moved(motion: np.ndarray) -> np.ndarray:
    here = ball()
    return make_images(Gaussians(here.means + motion, here.quats, here.scales, here.opacities, here.sh))


def test_large_displacement_finds_leap_beyond_object_size() -> None:
    here = make_images(ball())
    wrong = np.stack([error_masks(EMPTY, image).error for image in here])
    found = find_new_points(CAMERAS, here, sure(wrong), BACKGROUND, NEAR, NOTHING)
    motion = large_displacements(found.points, found.sizes, CAMERAS, here, moved(MOTION), BACKGROUND, NEAR)
    on_it = np.linalg.norm(found.points - CENTER, axis=1) < RADIUS + PIXEL
    assert on_it.sum() > 50
    np.testing.assert_allclose(np.median(motion[on_it], 0), MOTION, atol=2 * PIXEL)


def test_large_displacement_of_resting_or_vanished_object_is_zero() -> None:
    here = make_images(ball())
    points = ball().means[::10].astype(np.float32)
    sizes = np.full(len(points), 0.05, np.float32)
    empty = np.broadcast_to((EMPTY * 255).astype(np.uint8), here.shape)
    for there in (here, empty):
        motion = large_displacements(points, sizes, CAMERAS, here, np.ascontiguousarray(there), BACKGROUND, NEAR)
        assert np.abs(motion).max() < PIXEL


def test_large_displacement_ignores_few_points() -> None:
    here = make_images(ball())
    few = ball().means[:4].astype(np.float32)
    motion = large_displacements(few, np.full(4, 0.05, np.float32), CAMERAS, here, moved(MOTION), BACKGROUND, NEAR)
    np.testing.assert_array_equal(motion, 0)
    assert large_displacements(few[:0], np.zeros(0, np.float32), CAMERAS, here, here, BACKGROUND, NEAR).shape == (0, 3)
