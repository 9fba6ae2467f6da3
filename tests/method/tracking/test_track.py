"""Tracks of a patch of points that moves in front of a wall."""

import itertools
import tracemalloc

import numpy as np
import pytest
from scipy.spatial import KDTree

from splatreel.kernels.image import render_image
from splatreel.kernels.rigid import Views
from splatreel.method.images.flow import DisFlow, Flow
from splatreel.method.tracking.track import PointTracks, RigidPatches, Tracker
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.method.scenes import ring

WIDTH, HEIGHT, NEAR = 96, 64, 0.1
CAMERAS = ring(4, width=WIDTH, height=HEIGHT)
STEP = np.array([0.06, -0.03, 0.02])


def sheet(x: np.ndarray, y: np.ndarray, z: float, size: float, seed: int) -> Gaussians:
    """Return opaque points in rows and columns, facing the cameras, in smoothly varying colors."""
    means = np.stack(np.meshgrid(x, y, [z], indexing="ij"), -1).reshape(-1, 3)
    count = len(means)
    waves = np.random.default_rng(seed).normal(size=(3, 12, 3)) * [1 / size, 1 / size, 0] * 0.35
    sh = np.sin(means @ waves.reshape(-1, 3).T + np.arange(36)).reshape(count, 3, 12).sum(2)[:, None] * 0.5
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    return Gaussians(means, quats, np.tile([size, size, 0.02], (count, 1)), np.full(count, 0.98), sh)


WALL = sheet(np.linspace(-5, 5, 51), np.linspace(-3.5, 3.5, 36), 1.5, 0.12, 0)
PATCH = sheet(np.linspace(-0.6, 0.6, 13), np.linspace(-0.5, 0.5, 11), 0.0, 0.06, 1)


def paths(points: Gaussians, frames: int, turn: float = 0.0) -> np.ndarray:
    """Return positions [T, N, 3] of points that move by STEP and turn by `turn` about z in every frame."""
    found = []
    for t in range(frames):
        c, s = np.cos(turn * t), np.sin(turn * t)
        found.append(points.means @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + STEP * t)
    return np.stack(found).astype(np.float32)


def at(points: Gaussians, means: np.ndarray) -> Gaussians:
    return Gaussians(means, points.quats, points.scales, points.opacities, points.sh)


def project(means: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return [N, 2] pixels and [N] depth."""
    local = means @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    pixels = local @ camera.K.T
    return pixels[:, :2] / pixels[:, 2:], local[:, 2]


def furthest(tracks: np.ndarray, truth: np.ndarray) -> float:
    """Return the largest error of any track in any view and frame, pixels."""
    errors = [
        np.abs(project(a, camera)[0] - project(b, camera)[0]).max()
        for camera in CAMERAS
        for a, b in zip(tracks, truth, strict=True)
    ]
    return float(max(errors))


def white(points: Gaussians) -> Gaussians:
    return Gaussians(points.means, points.quats, points.scales, points.opacities, np.full_like(points.sh, 1.77))


class TrueFlow:
    """Flow of known paths [T, N, 3], zero away from them. Frames store their number and camera in their first pixel."""

    def __init__(self, truth: np.ndarray) -> None:
        self.truth = truth

    def frames(self) -> np.ndarray:
        images = np.zeros((len(self.truth), len(CAMERAS), HEIGHT, WIDTH, 3), np.uint8)
        images[:, :, 0, 0, 0] = np.arange(len(self.truth))[:, None]
        images[:, :, 0, 0, 1] = np.arange(len(CAMERAS))
        return images

    def __call__(
        self, a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None, wanted: np.ndarray | None = None
    ) -> np.ndarray:
        camera = CAMERAS[a[0, 0, 1]]
        here, there = (project(self.truth[image[0, 0, 0]], camera)[0] for image in (a, b))
        centers = np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), -1)
        distance, nearest = KDTree(here).query(centers)
        return np.where(distance[..., None] < 3, (there - here)[nearest], 0).astype(np.float32)


def follow(tracker: Tracker, points: Gaussians, start: int = 0) -> np.ndarray:
    """Return the tracks [T, N, 3] of points that are in place at frame `start`."""
    track = PointTracks(points, start)
    for frame in range(start, len(tracker.frames) - 1):
        tracker.step([track], frame)
    tracker.track_back([track])
    return track.positions


def track(truth: np.ndarray, points: Gaussians, static: Gaussians = WALL, start: int = 0) -> np.ndarray:
    flow = TrueFlow(truth)
    return follow(Tracker(static, CAMERAS, flow.frames(), flow, NEAR), at(points, truth[start]), start)


def test_tracks_follow_true_flow() -> None:
    truth = paths(PATCH, 6, turn=0.04)
    tracks = track(truth, PATCH)
    assert tracks.shape == truth.shape
    np.testing.assert_array_equal(tracks[0], truth[0])
    assert furthest(tracks, truth) < 1
    assert np.abs(tracks - truth).max() < 0.08, "depth is known from several views together"
    assert furthest(truth[[0] * 6], truth) > 8, "the points do move"


def test_rested_points_are_tracked_from_start_only() -> None:
    """Points rest until frame 2. Backward they stay in place, whatever the flow."""
    truth = paths(PATCH, 6, turn=0.04)
    tracker = Tracker(WALL, CAMERAS, TrueFlow(truth).frames(), TrueFlow(truth), NEAR)
    track = PointTracks(at(PATCH, truth[2]), 2, static_before=True)
    assert track.first == 0
    for frame in range(2, 5):
        tracker.step([track], frame)
    tracker.track_back([track])
    tracks = track.positions
    assert tracks.shape == truth.shape
    np.testing.assert_array_equal(tracks[:3], np.broadcast_to(truth[2].astype(np.float32), (3, *truth[2].shape)))
    assert furthest(tracks[2:], truth[2:]) < 1


def test_tracks_follow_flow_of_images() -> None:
    truth = paths(PATCH, 5, turn=0.03)
    images = [
        [render_image(Gaussians.concatenate([WALL, at(PATCH, means)]), camera, near=NEAR) for camera in CAMERAS]
        for means in truth
    ]
    frames = (np.clip(images, 0, 1) * 255).astype(np.uint8)
    tracks = follow(Tracker(WALL, CAMERAS, frames, DisFlow(), NEAR), PATCH)
    errors = np.stack(
        [
            np.linalg.norm(project(a, camera)[0] - project(b, camera)[0], axis=1)
            for camera in CAMERAS
            for a, b in zip(tracks, truth, strict=True)
        ]
    )
    assert np.percentile(errors, 95) < 1, "flow is unsure at the patch's corners only"
    assert errors.max() < 2.5
    assert furthest(truth[[0] * 5], truth) > 6


@pytest.mark.parametrize("start", [2, 5])
def test_later_points_are_tracked_both_ways(start: int) -> None:
    truth = paths(PATCH, 6)
    tracks = track(truth, PATCH, start=start)
    assert tracks.shape == truth.shape
    np.testing.assert_array_equal(tracks[start], truth[start])
    assert furthest(tracks, truth) < 1


def test_hidden_points_follow_neighbors() -> None:
    """A bar hides three columns of the patch in every view."""
    bar = sheet(np.array([-0.1, 0.0, 0.1]), np.linspace(-1, 1, 41), -0.35, 0.07, 2)
    truth = paths(PATCH, 4)
    tracks = track(truth, PATCH, Gaussians.concatenate([WALL, bar]))
    hidden = np.abs(PATCH.means[:, 0]) < 0.05
    assert hidden.any()
    assert furthest(tracks[:, hidden], truth[:, hidden]) < 1.5
    assert furthest(truth[[0] * 4][:, hidden], truth[:, hidden]) > 3


def test_unseen_points_keep_velocity() -> None:
    """The patch passes behind a screen and stays there."""
    small = PATCH[np.abs(PATCH.means).max(1) < 0.25]
    small = at(small, small.means - [1.3, 0, 0])
    step = np.array([0.2, 0, 0])
    truth = np.stack([small.means + step * t for t in range(10)]).astype(np.float32)
    screen = sheet(np.linspace(-0.6, 2.5, 46), np.linspace(-1, 1, 30), -0.2, 0.06, 3)
    covered = [render_image(white(screen), camera, near=NEAR).mean(-1) > 0.5 for camera in CAMERAS]
    flow = TrueFlow(truth)

    def screened(
        a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None, wanted: np.ndarray | None = None
    ) -> np.ndarray:
        return np.where(covered[a[0, 0, 1]][..., None], 0, flow(a, b))

    tracker = Tracker(Gaussians.concatenate([WALL, screen]), CAMERAS, flow.frames(), screened, NEAR)
    late = np.diff(follow(tracker, small), axis=0)[6:]
    np.testing.assert_allclose(late, np.broadcast_to(step, late.shape), atol=0.03)


def test_thrown_object_is_tracked() -> None:
    small = PATCH[np.abs(PATCH.means).max(1) < 0.25]
    way = np.arange(8) * (0.06 + 0.035 * np.arange(8))
    truth = (small.means + (way - 1.2)[:, None, None] * [1, 0, 0]).astype(np.float32)
    assert np.ptp(small.means[:, 0]) < 1.1 * np.diff(way)[-1]
    images = [
        [render_image(Gaussians.concatenate([WALL, at(small, means)]), camera, near=NEAR) for camera in CAMERAS]
        for means in truth
    ]
    frames, dis = (np.clip(images, 0, 1) * 255).astype(np.uint8), DisFlow()

    def unguided(
        a: np.ndarray, b: np.ndarray, guess: np.ndarray | None = None, wanted: np.ndarray | None = None
    ) -> np.ndarray:
        return dis(a, b)

    def error(flow: Flow, patches: bool) -> np.ndarray:
        """[T] of the points in the middle of the field."""
        tracker, track = Tracker(WALL, CAMERAS, frames, flow, NEAR), PointTracks(at(small, truth[0]), 0)
        if not patches:
            track.patches = RigidPatches(np.zeros((0, 3), np.float32), tracker.views(0, tracker.depths(small)))
        for frame in range(len(frames) - 1):
            tracker.step([track], frame)
        return np.median(np.linalg.norm(track.positions - truth, axis=2), 1)

    assert error(dis, patches=False).max() < 0.2
    assert error(unguided, patches=False)[-1] > 0.5
    assert error(unguided, patches=True).max() < 0.15, "they need no flow"


def test_tracks_of_no_point_and_one_point() -> None:
    truth = paths(PATCH, 4)
    middle = np.abs(PATCH.means).sum(1).argmin(keepdims=True)
    flow = TrueFlow(truth)
    assert follow(Tracker(WALL, CAMERAS, flow.frames(), flow, NEAR), Gaussians.empty(), 1).shape == (4, 0, 3)
    assert furthest(track(truth[:, middle], PATCH[middle]), truth[:, middle]) < 1


def test_tracking_keeps_flow_of_one_frame_pair() -> None:
    few = PATCH[::20]
    frames = np.zeros((24, len(CAMERAS), HEIGHT, WIDTH, 3), np.uint8)
    tracker = Tracker(
        WALL, CAMERAS, frames, lambda a, b, guess=None, wanted=None: np.zeros((HEIGHT, WIDTH, 2), np.float32), NEAR
    )
    peaks = []
    for last in (2, 23):
        tracemalloc.start()
        track = PointTracks(few, 0)
        for frame in range(last):
            tracker.step([track], frame)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    pair = len(CAMERAS) * HEIGHT * WIDTH * 2 * 2
    assert peaks[1] < peaks[0] + 3 * pair  # 21 pairs if all were kept; caches of libraries count, too


def test_depths_are_of_nearest_surface() -> None:
    truth = paths(PATCH, 2)
    flow = TrueFlow(truth)
    tracker = Tracker(WALL, CAMERAS, flow.frames(), flow, NEAR)
    depths = tracker.depths(PATCH)
    assert depths.shape == (len(CAMERAS), HEIGHT, WIDTH)
    for camera, depth in zip(CAMERAS, depths, strict=True):
        pixels, expected = project(PATCH.means[60:80], camera)
        column, row = pixels.astype(int).T
        np.testing.assert_allclose(depth[row, column], expected, rtol=0.02)
        wall = (1.5 - camera.center[2]) / camera.forward[2]
        assert depth[HEIGHT // 2, 4] > 4.2
        np.testing.assert_allclose(depth[4, WIDTH // 2], wall, rtol=0.1, err_msg="the wall")
    alone = Tracker(Gaussians.empty(), CAMERAS, flow.frames(), flow, NEAR).depths(PATCH)
    assert np.isinf(alone[:, 3, 3]).all()


PATCH_WIDTH, PATCH_HEIGHT = 144, 96
PATCH_CAMERAS = ring(6, width=PATCH_WIDTH, height=PATCH_HEIGHT)
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
    return (np.clip([render_image(scene, camera, near=NEAR) for camera in PATCH_CAMERAS], 0, 1) * 255).astype(np.uint8)


def eyes(means: np.ndarray, cameras: list[Camera] = PATCH_CAMERAS) -> Views:
    depths = np.full((len(cameras), PATCH_HEIGHT // 2, PATCH_WIDTH // 2), 1e30, np.float32)
    poses, lenses = np.stack([c.viewmat for c in cameras]), np.stack([c.K for c in cameras])
    return Views(poses, lenses, make_images(means), depths, np.float32(NEAR))


def test_rigid_patches_track_swinging_bar() -> None:
    truth = swing(10)
    assert np.median(np.linalg.norm(truth[-1] - truth[-2], axis=1)) > 2 * 0.06, "twice its width a frame"
    frames = np.stack([make_images(means) for means in truth])
    kept, alone = (PointTracks(at(bar(), truth[0]), 0) for _ in range(2))
    alone.patches = RigidPatches(truth[0][:2], eyes(truth[0]))  # too few points for a patch: flow only
    tracker = Tracker(WALL, PATCH_CAMERAS, frames, DisFlow(), NEAR)
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
