"""Rigid patches: a thin bar swings farther than its width, so that flow misses it."""

import itertools

import numpy as np

from splatreel.kernels.image import render_image
from splatreel.kernels.rigid import Views
from splatreel.method.images.flow import DisFlow
from splatreel.method.tracking.rigid_patches import RigidPatches
from splatreel.method.tracking.track import PointTracks, Tracker
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.method.scenes import ring
from tests.method.tracking.test_track import NEAR, WALL, at

WIDTH, HEIGHT = 144, 96
CAMERAS = ring(6, width=WIDTH, height=HEIGHT)
LENGTH = 0.9


def bar() -> Gaussians:
    """Return a thin bar with white and blue parts."""
    x, side = np.meshgrid(np.linspace(0, LENGTH, 46), np.linspace(-0.03, 0.03, 3), indexing="ij")
    means = np.stack([x.ravel(), side.ravel(), np.zeros(x.size)], 1)
    sh = np.where((means[:, :1] * 5 % 1 < 0.5), [[1.6, 1.6, 1.6]], [[-1.5, -1.2, 1.2]])[:, None]
    count = len(means)
    return Gaussians(means, np.tile([1.0, 0, 0, 0], (count, 1)), np.full((count, 3), 0.02), np.full(count, 0.98), sh)


def swing(frames: int) -> np.ndarray:
    """Return positions [T, N, 3] of a bar that turns about its end with growing speed, up to 0.35 per frame."""
    angles = np.concatenate([[0], np.cumsum(np.minimum(0.05 * np.arange(1, frames), 0.35))]) - 0.8
    turns = np.stack([[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in angles])
    return np.einsum("tij,nj->tni", turns, bar().means).astype(np.float32)


def make_images(means: np.ndarray) -> np.ndarray:
    scene = Gaussians.concatenate([WALL, at(bar(), means)])
    return (np.clip([render_image(scene, camera, near=NEAR) for camera in CAMERAS], 0, 1) * 255).astype(np.uint8)


def eyes(means: np.ndarray, cameras: list[Camera] = CAMERAS) -> Views:
    depths = np.full((len(cameras), HEIGHT // 2, WIDTH // 2), 1e30, np.float32)
    poses, lenses = np.stack([c.viewmat for c in cameras]), np.stack([c.K for c in cameras])
    return Views(poses, lenses, make_images(means), depths, np.float32(NEAR))


def test_rigid_patches_track_swinging_bar() -> None:
    truth = swing(10)
    assert np.median(np.linalg.norm(truth[-1] - truth[-2], axis=1)) > 2 * 0.06, "twice its width a frame"
    frames = np.stack([make_images(means) for means in truth])
    kept, alone = (PointTracks(at(bar(), truth[0]), 0) for _ in range(2))
    alone.patches = RigidPatches(truth[0][:2], eyes(truth[0]))  # too few points for a patch: flow only
    tracker = Tracker(WALL, CAMERAS, frames, DisFlow(), NEAR)
    for frame in range(len(frames) - 1):
        tracker.step([kept, alone], frame)
    errors = np.linalg.norm(kept.positions - truth, axis=2)
    assert np.median(errors, 1).max() < 0.05
    assert np.percentile(errors, 90) < 0.1
    assert np.percentile(np.linalg.norm(alone.positions[-1] - truth[-1], axis=1), 90) > 0.5


def test_rigid_patches_colors_follow_light() -> None:
    truth = np.repeat(swing(2)[:1], 9, axis=0)
    light = [
        eyes(truth[0])._replace(images=(make_images(truth[0]) * (1 - 0.01 * t)).astype(np.uint8)) for t in range(9)
    ]
    still, parts = np.zeros_like(truth[0]), RigidPatches(truth[0], light[0])
    first = parts.colors.copy()
    for now, then in itertools.pairwise(light):
        np.testing.assert_array_equal(parts.motion(truth[0], truth[0], still, now, then), still)
    bright = first > 200
    assert parts.colors[bright].mean() < 0.97 * first[bright].mean()


def test_rigid_patches_keep_correct_flow() -> None:
    truth = swing(4)
    now, then = eyes(truth[2]), eyes(truth[3])
    flow = truth[3] - truth[2]
    motion = RigidPatches(truth[2], now).motion(truth[2], truth[1], flow, now, then)
    assert np.abs(motion - flow).max() < 0.06, "its width"


def test_rigid_patches_of_vanished_object_keep_flow() -> None:
    """No motion explains images without the object."""
    truth = swing(4)
    now, gone = eyes(truth[2]), eyes(truth[3] + [0, 90, 0])
    flow = np.full_like(truth[2], 0.01)
    motion = RigidPatches(truth[2], now).motion(truth[2], truth[1], flow, now, gone)
    assert np.abs(motion - flow).max() < 0.6
    assert np.mean(np.abs(motion - flow).max(1) > 0) < 0.5


def test_rigid_patches_of_few_points_keep_flow() -> None:
    truth = swing(2)
    few = truth[:, :5]
    now, then = eyes(truth[0]), eyes(truth[1])
    flow = np.zeros_like(few[0])
    np.testing.assert_array_equal(RigidPatches(few[0], now).motion(few[0], few[0], flow, now, then), flow)
    nobody = np.zeros((0, 3), np.float32)
    assert RigidPatches(nobody, now).motion(nobody, nobody, nobody, now, then).shape == (0, 3)
