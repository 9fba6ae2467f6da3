"""Depth ranges of distant long lenses follow the shared depths; other rigs keep theirs."""

import cv2
import numpy as np
import pytest

from splatreel.method.init import planesweep
from splatreel.method.init.initial_points import SWEEP_PLANES, SWEEP_WIDTH, depth_ranges, initial_points
from splatreel.method.init.planesweep import WANTED_SPACING, narrow_ranges, pixels_apart, shared_depths
from splatreel.method.init.triangulate import nearest_cameras
from splatreel.scene.camera import Camera
from tests.method.corner import arc, texture
from tests.method.scenes import ring
from toyroom.capture import make_cameras

DISTANCE, WIDTH, HEIGHT = 30.0, 240, 176
NONE = np.zeros((0, 3))


def telephoto(count: int = 5, degrees: float = 60.0) -> list[Camera]:
    """Return cameras 30 units away at these angles, with a field of view of 14.5 degrees: focal length 16,041 for 4096 pixels."""
    focal = 16041 * WIDTH / 4096
    K = np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    cameras = []
    for i, angle in enumerate(np.radians(np.linspace(-degrees / 2, degrees / 2, count))):
        viewmat = np.eye(4)
        viewmat[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        viewmat[2, 3] = DISTANCE
        cameras.append(Camera(f"cam{i}", viewmat, K, WIDTH, HEIGHT))
    return cameras


def relief(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the image [H, W, 3] uint8 and depth [H, W] of a textured, tilted wall, z = y / 2."""
    rays = planesweep.unproject(camera, np.ones((HEIGHT, WIDTH))) - camera.center
    normal = np.array([0, -0.5, 1])
    depth = -(camera.center @ normal) / (rays @ normal)
    places = camera.center + rays * depth[..., None]
    u, v = ((places[..., :2] + 4) * 60 % 511).astype(np.float32).transpose(2, 0, 1)
    return cv2.remap(texture(3), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT).astype(np.uint8), depth


@pytest.mark.slow
def test_narrow_ranges_follows_subject() -> None:
    cameras = telephoto()
    images, truths = zip(*map(relief, cameras), strict=True)
    before = depth_ranges(cameras, NONE)
    ranges, planes = narrow_ranges(cameras, before, WIDTH, SWEEP_PLANES)
    assert (ranges[:, 0] > 1.5 * before[:, 0]).all()
    assert (ranges[:, 0] < DISTANCE - 3).all()
    assert (ranges[:, 1] > DISTANCE + 3).all()
    errors = []
    for swept, count in ((before, SWEEP_PLANES), (ranges, planes)):
        maps = planesweep.sweep(cameras, np.stack(images), swept, width=WIDTH, planes=count)
        errors.append(np.median([np.abs(m.depth - truth) for m, truth in zip(maps, truths, strict=True)]))
    assert errors[1] < 0.05 < errors[0] / 4


def test_narrow_ranges_spaces_planes_by_pixels() -> None:
    cameras = telephoto()
    nearest = nearest_cameras(cameras, planesweep.NEIGHBORS)
    before = depth_ranges(cameras, NONE)
    ranges, planes = narrow_ranges(cameras, before, WIDTH, SWEEP_PLANES)
    others = [cameras[j] for j in nearest[2]]
    assert pixels_apart(cameras[2], others, before[2], SWEEP_PLANES) > 10
    assert pixels_apart(cameras[2], others, ranges[2], int(planes[2])) == pytest.approx(WANTED_SPACING, rel=0.1)


@pytest.mark.parametrize("cameras", [arc(5), ring(6, width=48, height=32), make_cameras(256, 192)])
def test_narrow_ranges_keeps_other_rigs(cameras: list[Camera]) -> None:
    before = depth_ranges(cameras, NONE)
    ranges, planes = narrow_ranges(cameras, before, min(SWEEP_WIDTH, cameras[0].width), SWEEP_PLANES)
    assert np.array_equal(ranges, before)
    assert (planes == SWEEP_PLANES).all()


def test_narrow_ranges_without_overlap_keeps_range() -> None:
    ahead, aside = telephoto(2, 180.0)
    depths = np.array([1.0, 5.0])
    assert np.array_equal(shared_depths(ahead, [aside], depths), depths)


@pytest.mark.slow
def test_initial_points_of_long_lenses_lie_on_subject() -> None:
    cameras = telephoto()
    points = initial_points(cameras, np.stack([relief(camera)[0] for camera in cameras])).points
    assert len(points) > 1000
    assert np.median(np.abs(points[:, 2] - points[:, 1] / 2)) < 0.05
