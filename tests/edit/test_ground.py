"""Tests of `edit/ground.py`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import UsageError
from splatreel.edit import ground
from splatreel.edit.clip_writer import write_clip
from splatreel.edit.ground import Grounded, _best, _gaussians, _Plane
from splatreel.edit.operations import apply_operations
from splatreel.edit.reel_clip import ReelClip
from splatreel.play.timeline import open_reel
from splatreel.scene.camera import Camera, facing, unproject
from splatreel.scene.gaussians import Gaussians
from tests.edit.clips import all_points, write_reel
from tests.golden import random_gaussians

UP = np.array([0.0, 1.0, 0.0])
FLOOR = -0.9
PLANE = _Plane(np.array([0.0, -1.0, 0.0]), UP, np.array([1.0, 0, 0]), np.array([1.0, 1.0]), 1.0)
"""Plane at the feet of a subject that is 1 high, 0.1 below the floor."""


def cameras() -> list[Camera]:
    """Return four cameras that look down at the subject."""
    found = []
    for number, angle in enumerate(np.radians([0, 80, 170, 260])):
        center = np.array([3 * np.sin(angle), 1.5, 3 * np.cos(angle)])
        target = np.array([0, -0.6, 0])
        found.append(
            facing(f"cam{number}", center, (target - center) / np.linalg.norm(target - center), 160, 160, 120, up=UP)
        )
    return found


def checked_floor(camera: Camera) -> np.ndarray:
    """Return the image [H, W, 3] 0..1 of a floor with soft colored squares at the height FLOOR."""
    rays = unproject(camera, np.ones((camera.height, camera.width))) - camera.center
    places = camera.center + rays * ((FLOOR - camera.center[1]) / np.minimum(rays[..., 1], -1e-6))[..., None]
    x, z = places[..., 0], places[..., 2]
    return np.stack([0.5 + 0.3 * np.sin(7 * x), 0.5 + 0.3 * np.sin(6 * z), 0.5 + 0.2 * np.sin(5 * (x + z))], -1)


def test_plane_is_where_the_cameras_agree() -> None:
    rig = cameras()
    noise = np.random.default_rng(0).normal(0, 0.05, (4, 120, 160, 3))
    found = _best(PLANE, rig, np.stack([checked_floor(camera) for camera in rig]) + noise)
    assert abs(found.center[1] - FLOOR) < 0.02
    assert np.array_equal(found.up, UP), "level, although noise agrees a little better in a tilted plane"


def test_plane_is_tilted_where_the_cameras_agree_much_better() -> None:
    rig = cameras()
    up = np.array([np.sin(np.radians(-3)), np.cos(np.radians(3)), 0])
    found = _best(
        replace(PLANE, up=up, right=np.array([up[1], -up[0], 0])),
        rig,
        np.stack([checked_floor(camera) for camera in rig]),
    )
    assert found.up @ UP > np.cos(np.radians(1.5))


def test_points_have_the_colors_of_the_floor_and_fade_at_the_border() -> None:
    rig = cameras()
    plates = np.stack([checked_floor(camera) for camera in rig])
    points = _gaussians(PLANE.raised(0.1), rig, plates, 0.1)
    x = points.means[:, 0]
    assert np.abs(points.base_colors[:, 0] - (0.5 + 0.3 * np.sin(7 * x))).mean() < 0.03
    out = np.hypot(points.means[:, 0], points.means[:, 2])
    assert points.opacities[out < 0.5].min() > 0.9
    assert points.opacities[out > 0.95].max() < 0.2
    assert np.ptp(points.means[:, 1]) < 1e-5


def test_place_that_no_camera_shows_takes_the_colors_around_it() -> None:
    rig = [replace(camera, K=camera.K * np.array([[3], [3], [1]], np.float32)) for camera in cameras()]
    plates = np.full((4, 120, 160, 3), 0.3)
    points = _gaussians(PLANE, rig, plates, 0.1)
    assert np.allclose(points.base_colors, 0.3, atol=0.01)


def test_texture_fades_into_a_plain_floor_where_nothing_is_known() -> None:
    """Cameras show a small part of the floor. Each has a wall of another color behind it."""
    rig = cameras()
    plates = np.stack([checked_floor(camera) for camera in rig])
    x, z = _gaussians(PLANE.raised(0.1), rig, plates, 0.1).means[:, [0, 2]].T
    for number, (camera, plate) in enumerate(zip(rig, plates, strict=True)):
        rays = unproject(camera, np.ones((camera.height, camera.width))) - camera.center
        places = camera.center + rays * ((FLOOR - camera.center[1]) / np.minimum(rays[..., 1], -1e-6))[..., None]
        plate[np.hypot(places[..., 0], places[..., 2]) > 0.5] = np.eye(4)[number, :3]
    points = _gaussians(PLANE.raised(0.1), rig, plates, 0.1)
    assert np.allclose(points.means[:, [0, 2]].T, [x, z]), "the outline does not depend on what is known"
    out = np.hypot(x, z)
    plain = points.base_colors[out > 0.75]
    assert np.ptp(plain, axis=0).max() < 0.02
    near = points.base_colors[out < 0.35]
    assert np.abs(near[:, 0] - (0.5 + 0.3 * np.sin(7 * x[out < 0.35]))).mean() < 0.03
    assert np.abs(plain.mean(0) - np.median(near, 0)).max() < 0.15


def test_plane_that_no_two_cameras_show_stays_at_the_feet() -> None:
    rig = cameras()[:1]
    assert _best(PLANE, rig, np.stack([checked_floor(rig[0])])) == PLANE


def test_ground_is_one_more_layer_in_all_frames(tmp_path: Path) -> None:
    reel = write_reel(tmp_path / "reel")
    floor = random_gaussians(np.random.default_rng(1), 50, 0, (0, -5, 0))
    floor = Gaussians(floor.means, floor.quats, floor.scales, np.full(50, 0.9), floor.sh)
    write_clip(Grounded(ReelClip(reel), floor), tmp_path / "out")
    before, after = open_reel(reel), open_reel(tmp_path / "out")
    for frame in (0.0, 8.0, 16.0):
        assert len(all_points(after, frame)) == len(all_points(before, frame)) + 50
    cut = apply_operations(Grounded(ReelClip(reel), floor), ["cut=7:12"])
    write_clip(cut, tmp_path / "cut")
    assert (all_points(open_reel(tmp_path / "cut"), 0.0).means[:, 1] < -3).sum() == 50


class Filmed:
    """Stand-in of a capture, which shows gray."""

    def __init__(self, rig: list[Camera], width: int, height: int) -> None:
        self.cameras, self.width, self.height, self.frames = rig, width, height, 2

    def read(self, first: int, count: int, names: list[str]) -> np.ndarray:
        return np.full((count, len(names), self.height, self.width, 3), 128, np.uint8)

    def close(self) -> None: ...


def test_capture_of_other_cameras_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = []

    def open_capture(path: str, **_: object) -> Filmed:
        opened.append(path)
        return filmed

    monkeypatch.setattr(ground, "open_capture", open_capture)
    filmed, clip = Filmed(cameras(), 160, 120), ReelClip(write_reel(tmp_path / "reel"))
    with pytest.raises(UsageError, match="has no camera 'cam00'"):
        apply_operations(clip, ["ground=s3://bucket/capture"])
    assert opened == ["s3://bucket/capture"], "an address stays an address"
    rig = list(clip.outline.header.cameras)
    filmed = Filmed(rig, rig[0].width, rig[0].height + 2)
    with pytest.raises(UsageError, match=r"whose cameras have .* pixels. Name that reel's capture"):
        apply_operations(clip, ["ground=film"])
    filmed = Filmed(rig, rig[0].width, rig[0].height)
    nothing = Gaussians.empty(0)
    monkeypatch.setattr(ground, "shown_points", lambda *_: (nothing, None))
    with pytest.raises(UsageError, match="shows nothing that could stand on a floor"):
        apply_operations(clip, ["ground=film"])
    with pytest.raises(UsageError, match="Name the folder of the capture"):
        apply_operations(ReelClip(tmp_path / "reel"), ["ground="])
