"""Crops and removal of floaters."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import UsageError
from splatreel.edit.operations import apply_operations
from splatreel.edit.reel_clip import ReelClip
from splatreel.play.timeline import Timeline, open_reel
from splatreel.scene.camera import facing
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from tests.codec.reels import QUICK, new_writer
from tests.edit.clips import all_points, edit, make_image, psnr, write_reel


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_reel(tmp_path_factory.mktemp("reel") / "reel")


def fraction(volume: str, means: np.ndarray) -> np.ndarray:
    """Return which points are inside, to a tolerance for the quantization of motion."""
    slack = 0.05
    if volume.startswith("box"):
        return np.asarray(((means > np.array([-0.5, -1, -1]) - slack) & (means < np.array([1, 1, 0.6]) + slack)).all(1))
    if volume.startswith("sphere"):
        return np.linalg.norm(means - (0.5, 0.2, 0), axis=1) < 0.9 + slack
    return (np.hypot(means[:, 0], means[:, 2]) < 0.9 + slack) & (np.abs(means[:, 1] - 0.4) < 0.6 + slack)


@pytest.mark.parametrize("volume", ["box:-0.5,-1,-1,1,1,0.6", "sphere:0.5,0.2,0,0.9", "cylinder:0,1,0,0.9,1.2"])
def test_crop_leaves_nothing_outside(reel: Path, tmp_path: Path, volume: str) -> None:
    cropped, original = edit(reel, tmp_path / "cropped", f"crop={volume}"), open_reel(reel)
    for frame in (0, 2, 5, 9, 17):
        found, all_ = all_points(cropped, frame), all_points(original, frame)
        assert fraction(volume, found.means).all()
        assert 0 < len(found) < len(all_)
    assert (cropped.manifest.bounds[0] >= original.manifest.bounds[0]).all()
    assert (cropped.manifest.bounds[1] <= original.manifest.bounds[1]).all()


def test_remove_is_the_opposite_of_crop(reel: Path, tmp_path: Path) -> None:
    kept = edit(reel, tmp_path / "kept", "crop=sphere:0.5,0.2,0,0.9")
    rest = edit(reel, tmp_path / "rest", "remove=sphere:0.5,0.2,0,0.9")
    counts = [len(reel_.at(0)) for reel_ in (kept, rest, open_reel(reel))]
    assert counts[0] + counts[1] >= counts[2]
    assert len(all_points(kept, 0)) + len(all_points(rest, 0)) == pytest.approx(
        len(all_points(open_reel(reel), 0)), abs=4
    )


def test_crop_to_nothing_is_refused(reel: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no point is left"):
        edit(reel, tmp_path / "none", "crop=sphere:50,50,50,1")
    assert list(tmp_path.iterdir()) == []


def room(path: Path, dynamic: Gaussians | None = None, shade: np.ndarray | None = None) -> Path:
    """Write a reel of a wall that four cameras see, a floater near the first camera, and a point behind the wall."""
    side = np.linspace(-1, 1, 41)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side))
    wall = np.stack([x, y, np.full_like(x, 4.0)], 1)
    means = np.concatenate([wall, [[-1.0, -1.0, 0.9], [0.0, 0.0, 4.6]]])
    count = len(means)
    scales = np.full((count, 3), 0.04)
    points = Gaussians(
        means, np.tile([1.0, 0, 0, 0], (count, 1)), scales, np.full(count, 0.95), np.zeros((count, 1, 3))
    )
    places = [(-1, -1), (1, -1), (-1, 1), (1, 1)]
    cameras = []
    for number, (x0, y0) in enumerate(places):
        center = np.array([x0, y0, 0.0])
        ahead = np.array([0, 0, 4.0]) - center
        cameras.append(facing(f"cam{number}", center, ahead / np.linalg.norm(ahead), 90, 100, 100))
    writer = new_writer(path, cameras=cameras, camera=cameras[1], sh_degree=0, config=QUICK)
    writer.add_layer(0, 0, points)
    frames = 6 if shade is None else len(shade)
    moving = Gaussians.empty(0) if dynamic is None else dynamic
    dx = np.zeros((frames, len(moving), 3), np.float32)
    dq = np.tile(np.array([1, 0, 0, 0], np.float32), (frames, len(moving), 1))
    writer.add_group(Group(0, 0, moving, dx, dq, np.ones(count, bool), shade))
    writer.finish()
    return path


def near(reel: Timeline, place: tuple[float, float, float], frame: float = 0) -> int:
    shown = all_points(reel, frame)
    return int((np.linalg.norm(shown.means - place, axis=1) < 0.15).sum())


FLOATER, HIDDEN = (-1.0, -1.0, 0.9), (0.0, 0.0, 4.6)


def test_floater_that_few_cameras_saw_disappears(tmp_path: Path) -> None:
    before = open_reel(room(tmp_path / "room"))
    assert (near(before, FLOATER), near(before, HIDDEN)) == (1, 1)
    after = edit(tmp_path / "room", tmp_path / "clean", "min-cameras=2")
    assert (near(after, FLOATER), near(after, HIDDEN)) == (0, 0)
    assert len(after.at(0)) > 0.95 * len(before.at(0))
    assert psnr(make_image(before, 0), make_image(after, 0)) > 35


def test_faint_huge_far_and_short_lived_points_disappear(tmp_path: Path) -> None:
    means = np.array([[0.0, 0, 2], [0.1, 0, 2], [0.2, 0, 2], [0.3, 0, 40], [0.4, 0, 2]])
    scales = np.full((5, 3), 0.05)
    scales[2] = 3.0
    opacities = np.array([0.9, 0.02, 0.9, 0.9, 0.0])
    points = Gaussians(means, np.tile([1.0, 0, 0, 0], (5, 1)), scales, opacities, np.zeros((5, 1, 3)))
    shade = np.zeros((6, 5, 4), np.float32)
    shade[2:4, 4, 3] = 0.8
    reel = room(tmp_path / "room", points, shade)
    kept = {
        "min-opacity=0.1": [0, 2, 3, 4],
        "max-size=1": [0, 1, 3, 4],
        "max-distance=20": [0, 1, 2, 4],
        "min-seconds=0.3": [0, 1, 2, 3],
        "min-seconds=0.2": [0, 1, 2, 3, 4],
    }
    for operation, expected in kept.items():
        group = apply_operations(ReelClip(reel), [operation]).group(0).group
        found = sorted(np.abs(group.dynamic.means[:, None, 0] - means[:, 0]).argmin(1).tolist())
        assert found == expected, operation


def test_removal_for_some_frames_leaves_the_others(reel: Path, tmp_path: Path) -> None:
    volume = "sphere:0.5,0.2,0,3"
    after, before = edit(reel, tmp_path / "after", f"remove={volume}@0:2"), open_reel(reel)
    assert len(after.at(0)) < 0.2 * len(before.at(0))
    assert psnr(make_image(after, 10), make_image(before, 10)) > 90
    assert psnr(make_image(after, 15), make_image(before, 15)) > 90


def test_capture_volume_is_what_half_of_the_cameras_see(tmp_path: Path) -> None:
    after = edit(room(tmp_path / "room"), tmp_path / "seen", "crop=capture:0.75")
    assert near(after, FLOATER) == 0
    assert near(after, (0.0, 0.0, 4.0)) > 0


def test_static_points_keep_their_alive_flags(reel: Path) -> None:
    whole, cropped = ReelClip(reel), apply_operations(ReelClip(reel), ["crop=box:-9,-9,-9,0,9,9"])
    for index in range(len(whole.outline.groups)):
        for layer, flags in cropped.group(index).alive.items():
            inside = whole.layer(layer).points.means[:, 0] <= 0
            np.testing.assert_array_equal(flags, whole.group(index).alive[layer][inside])
