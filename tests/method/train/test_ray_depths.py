"""Depths that several views agree on: a textured wall at a known depth, rendered too near or too far."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splatreel.method.train import ray_depths
from splatreel.method.train.error_points import points_at_errors
from splatreel.method.train.ray_depths import RayDepths
from splatreel.method.train.render import View, deformed, draw
from splatreel.method.train.trainable_points import to_params
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.camera import Camera
from tests.method.captures import blots
from tests.method.scenes import ring

WIDTH, HEIGHT = 96, 64
CAMERAS = ring(4, width=WIDTH, height=HEIGHT)
NOISE = cv2.GaussianBlur(np.random.default_rng(0).random((400, 400)).astype(np.float32), (0, 0), 4.0)
TEXTURE = 255 * (NOISE - NOISE.min()) / (NOISE.max() - NOISE.min())
PIXELS = np.array([row * WIDTH + column for row in range(16, 48, 6) for column in range(24, 72, 6)])
KNOWN = np.ones((HEIGHT, WIDTH), bool)


def wall(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the image [H, W, 3] uint8 and the depth [H, W] of the textured wall z = 1."""
    row, column = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    rays = [(column - camera.K[0, 2]) / camera.K[0, 0], (row - camera.K[1, 2]) / camera.K[1, 1], np.ones_like(row)]
    world = np.stack(rays, -1) @ camera.viewmat[:3, :3]
    depth = (1 - camera.center[2]) / world[..., 2]
    places = (camera.center + world * depth[..., None] + 4) * 50
    x, y = (places[..., axis].astype(np.float32) for axis in (0, 1))
    image = cv2.remap(TEXTURE, x, y, cv2.INTER_LINEAR)
    return np.repeat(image.round().astype(np.uint8)[..., None], 3, -1), depth


IMAGES, DEPTHS = (np.stack(parts) for parts in zip(*map(wall, CAMERAS), strict=True))


WALL = blots(1500, [-4, -3, 0.6], [4, 3, 0.6], 0.1, 0)


def search(cameras: int = len(CAMERAS), images: np.ndarray = IMAGES, unknown: np.ndarray | None = None) -> RayDepths:
    views = [View.of(camera) for camera in CAMERAS[:cameras]]
    mask = None if unknown is None else unknown[None]
    return RayDepths(TrainingImages(images[:cameras][None], views, 0.1, 4.0, mask))


def errors(found: np.ndarray, camera: int) -> np.ndarray:
    return np.abs(found / DEPTHS[camera].ravel()[PIXELS] - 1)


@pytest.mark.parametrize("factor", [0.93, 1.07])
def test_wrong_depths_are_corrected(factor: float) -> None:
    tried = search()
    for camera in range(len(CAMERAS)):
        found = tried.agreed(camera, PIXELS, DEPTHS[camera] * factor, KNOWN)
        assert np.median(errors(found, camera)) < 0.02, "of 0.07"


def test_pixels_are_searched_in_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = search().agreed(1, PIXELS, DEPTHS[1] * 1.07, KNOWN)
    monkeypatch.setattr(ray_depths, "BATCH", 7)
    np.testing.assert_array_equal(search().agreed(1, PIXELS, DEPTHS[1] * 1.07, KNOWN), whole)


def test_correct_depths_are_kept() -> None:
    np.testing.assert_allclose(search().agreed(1, PIXELS, DEPTHS[1], KNOWN), DEPTHS[1].ravel()[PIXELS])


def test_pixels_without_a_depth_do_not_bend_the_surface() -> None:
    """Pixels that show nothing are rendered at the near plane."""
    known, depth = KNOWN.copy(), DEPTHS[1] * 1.07
    known[::3, ::3] = False
    depth[~known] = 0.1
    pixels = PIXELS[known.ravel()[PIXELS]]
    found = search().agreed(1, pixels, depth, known)
    assert np.median(np.abs(found / DEPTHS[1].ravel()[pixels] - 1)) < 0.02


def test_rendered_depths_are_kept_where_nothing_can_be_compared() -> None:
    rendered = 0.93 * DEPTHS[1].ravel()[PIXELS]
    plain, unknown = np.full_like(IMAGES, 120), np.ones(IMAGES.shape[:3], bool)
    unknown[1] = False
    for tried in (search(images=plain), search(unknown=unknown), search(cameras=2)):
        np.testing.assert_allclose(tried.agreed(1, PIXELS, DEPTHS[1] * 0.93, KNOWN), rendered)
    assert len(search().agreed(1, PIXELS[:0], DEPTHS[1], KNOWN)) == 0


def test_points_at_errors_take_the_depth_that_views_agree_on() -> None:
    """The points so far are a plain wall, 0.4 in front of the textured one."""
    params = to_params(replace(WALL, sh=np.zeros_like(WALL.sh)))
    views = [View.of(camera) for camera in CAMERAS]
    images = TrainingImages(IMAGES[None], views, 0.1, 4.0)

    def draw_camera(camera: int):
        splats = deformed(params, None, None, views[camera], 0.1)
        return splats, draw(splats, views[camera])[0]

    rng, gains = np.random.default_rng(0), np.ones((len(CAMERAS), 3), np.float32)
    means = points_at_errors(draw_camera, images, gains, 3, 200, rng)["means"]
    central = means[np.abs(means[:, :2]).max(1) < 1.5]
    assert len(central) > 40
    assert np.mean(np.abs(central[:, 2] - 1) < 0.2) > 0.5, "rendered depths are 0.4 away"
