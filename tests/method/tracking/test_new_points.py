"""New points for a ball that the scene lacks."""

import numpy as np

from splatreel.kernels.image import render_image
from splatreel.method.tracking.new_points import ErrorMasks, error_masks, find_new_points
from splatreel.method.tracking.tracking import large_displacements
from splatreel.scene.gaussians import Gaussians
from tests.method.scenes import ring

WIDTH, HEIGHT, NEAR = 96, 64, 0.8
CAMERAS = ring(5, width=WIDTH, height=HEIGHT)
PIXEL = 4 / WIDTH
"""World size of a pixel at the ball: the cameras are four units away and as long as they are wide."""
CENTER, RADIUS = np.array([0.3, -0.1, 0.2]), 0.35


def ball() -> Gaussians:
    """Return opaque points on a sphere, in slowly varying colors that differ from the background."""
    directions = np.random.default_rng(0).normal(size=(1500, 3))
    means = CENTER + RADIUS * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    count = len(means)
    reds = 0.8 + 0.2 * np.sin(9 * means[:, 1])
    colors = np.stack([reds, 0.5 + 0.4 * np.sin(11 * means[:, 0]), 0.1 + 0.1 * np.sin(7 * means[:, 2])], 1)
    sh = ((colors - 0.5) / 0.28209479)[:, None]
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    return Gaussians(means, quats, np.full((count, 3), 0.03), np.full(count, 0.99), sh)


def make_images(scene: Gaussians) -> np.ndarray:
    images = [render_image(scene, camera, near=NEAR, background=(0.2, 0.4, 0.6)) for camera in CAMERAS]
    return (np.clip(images, 0, 1) * 255).astype(np.uint8)


EMPTY = np.tile(np.array([0.2, 0.4, 0.6], np.float32), (HEIGHT, WIDTH, 1))
BACKGROUND = np.full((len(CAMERAS), HEIGHT, WIDTH), 6, np.float32)
NOTHING = np.zeros((0, 3), np.float32)


def sure(wrong: np.ndarray) -> ErrorMasks:
    """Return masks without uncertain pixels."""
    return ErrorMasks(wrong, wrong)


def test_new_points_find_missing_ball() -> None:
    images = make_images(ball())
    wrong = np.stack([error_masks(EMPTY, image).error for image in images])
    found = find_new_points(CAMERAS, images, sure(wrong), BACKGROUND, NEAR, NOTHING)
    assert len(found.points) > 100
    off = np.abs(np.linalg.norm(found.points - CENTER, axis=1) - RADIUS) / PIXEL
    assert np.median(off) < 2
    assert np.percentile(off, 80) < 4
    assert (found.colors[:, 0] > found.colors[:, 2]).mean() > 0.9, (
        "red over blue, as the ball is, but for its blurred rim"
    )
    assert found.sizes.shape == (len(found.points),)
    assert (found.sizes > 0.2 * PIXEL).all()
    assert (found.sizes < 4 * PIXEL).all()


def test_new_points_are_deterministic_per_seed() -> None:
    images = make_images(ball())
    wrong = np.stack([error_masks(EMPTY, image).error for image in images])
    a, b = (find_new_points(CAMERAS, images, sure(wrong), BACKGROUND, NEAR, NOTHING, seed=3) for _ in range(2))
    assert len(a.points)
    np.testing.assert_array_equal(a.points, b.points)


def test_new_points_without_errors_are_empty() -> None:
    images = make_images(ball())
    found = find_new_points(CAMERAS, images, sure(np.zeros((5, HEIGHT, WIDTH), bool)), BACKGROUND, NEAR, NOTHING)
    assert found.points.shape == found.colors.shape == (0, 3)
    assert found.sizes.shape == (0,)


def test_new_points_need_three_views() -> None:
    images = make_images(ball())
    wrong = np.stack([error_masks(EMPTY, image).error for image in images])
    for views in (1, 2):
        few = wrong.copy()
        few[views:] = False
        assert len(find_new_points(CAMERAS, images, sure(few), BACKGROUND, NEAR, NOTHING).points) == 0


def test_new_points_need_agreeing_colors() -> None:
    images = make_images(ball())
    wrong = np.stack([error_masks(EMPTY, image).error for image in images])
    for c, image in enumerate(images):
        image[wrong[c]] = [(0, 0, 0), (255, 255, 255), (255, 0, 0), (0, 255, 0), (0, 0, 255)][c]
    assert len(find_new_points(CAMERAS, images, sure(wrong), BACKGROUND, NEAR, NOTHING).points) == 0


def test_new_points_are_not_behind_visible_surface() -> None:
    images = make_images(ball())
    wrong = np.stack([error_masks(EMPTY, image).error for image in images])
    found = find_new_points(CAMERAS, images, sure(wrong), np.full_like(BACKGROUND, 2.0), NEAR, NOTHING)
    for camera in CAMERAS:
        depth = found.points @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        assert (depth < 3).all(), "the ball is four units away, behind a surface at two"


def test_new_points_ignore_occluded_views() -> None:
    """A known person stands in front of the ball in two of five views, which therefore show no error."""
    images = make_images(ball())
    wrong = np.stack([error_masks(EMPTY, image).error for image in images])
    wrong[:2] = False
    assert len(find_new_points(CAMERAS, images, sure(wrong), BACKGROUND, NEAR, NOTHING).points) == 0
    depths = BACKGROUND.copy()
    depths[:2] = 2.0
    found = find_new_points(CAMERAS, images, sure(wrong), depths, NEAR, NOTHING)
    assert len(found.points) > 50
    assert np.median(np.abs(np.linalg.norm(found.points - CENTER, axis=1) - RADIUS)) < 2 * PIXEL


def test_uncertain_masks_confirm_errors_away_from_moving_points() -> None:
    """Only two or three views see an object in front of a wall of another color."""
    images = make_images(ball())
    wrong = np.stack([error_masks(EMPTY, image).error for image in images])
    uncertain = wrong.copy()
    wrong[2:] = False
    found = find_new_points(CAMERAS, images, ErrorMasks(wrong, uncertain), BACKGROUND, NEAR, NOTHING)
    assert len(found.points) > 50
    assert np.median(np.abs(np.linalg.norm(found.points - CENTER, axis=1) - RADIUS)) < 2 * PIXEL
    there = ball().means
    elsewhere = find_new_points(CAMERAS, images, ErrorMasks(wrong, uncertain), BACKGROUND, NEAR, there + np.float32(3))
    np.testing.assert_array_equal(elsewhere.points, found.points)
    close = find_new_points(CAMERAS, images, ErrorMasks(wrong, uncertain), BACKGROUND, NEAR, there)
    assert len(close.points) < 0.2 * len(found.points), "those that are not on the ball"


def test_error_masks_mark_pale_object_uncertain() -> None:
    truth = np.full((HEIGHT, WIDTH, 3), 110, np.uint8)
    image = np.full((HEIGHT, WIDTH, 3), 110 / 255, np.float32)
    truth[20:40, 30:60] = 110 + round(0.07 * 255)
    found = error_masks(image, truth)
    assert not found.error.any()
    assert found.uncertain[23:37, 33:57].all()
    assert found.uncertain.sum() < 24 * 34


def test_error_masks_ignore_noise_and_thin_edges() -> None:
    truth = np.random.default_rng(0).integers(90, 130, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    image = np.full((HEIGHT, WIDTH, 3), 110 / 255, np.float32)
    assert not error_masks(image, truth).error.any()
    edge = truth.copy()
    edge[:, 40] = 255
    assert not error_masks(image, edge).error[:, :36].any()
    block = truth.copy()
    block[20:40, 30:60] = 250
    mask = error_masks(image, block).error
    assert mask[23:37, 33:57].all()
    assert mask.sum() < 24 * 34


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


def test_large_displacement_of_static_or_vanished_object_is_zero() -> None:
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
