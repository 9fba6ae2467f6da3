"""Moved, turned and scaled reels look the same from moved cameras."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.codec.header import ReelHeader
from splatreel.edit.operations import apply_operations
from splatreel.edit.placement import Similarity
from splatreel.edit.reel_clip import ReelClip
from splatreel.play.timeline import open_reel
from splatreel.scene.camera import facing
from splatreel.scene.gaussians import Gaussians
from tests.codec.reels import new_group, new_writer
from tests.edit.clips import edit, make_image, psnr, worst, write_reel
from tests.golden import camera

FRAMES = (0, 3, 6.5, 8, 15)


@pytest.fixture(scope="module")
def reel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_reel(tmp_path_factory.mktemp("reel") / "reel")


@pytest.mark.parametrize(
    ("operation", "least"),
    [
        ("move=10,-20,3", 90.0),
        ("scale=2", 40.0),
        ("scale=0.037", 40.0),
        ("rotate=y,90", 40.0),
        ("rotate=1,2,-1,37", 40.0),
        ("up=z", 40.0),
        ("up=-y", 90.0),
    ],
)
def test_moved_reel_looks_the_same_from_its_moved_camera(
    reel: Path, tmp_path: Path, operation: str, least: float
) -> None:
    moved, original = edit(reel, tmp_path / "moved", operation), open_reel(reel)
    assert worst(moved, original, [(frame, frame) for frame in FRAMES]) > least


def test_turned_reel_turns_back(reel: Path, tmp_path: Path) -> None:
    operations = "rotate=z,30", "scale=3", "move=1,2,3", "move=-1,-2,-3", "scale=0.33333333333", "rotate=z,-30"
    same, original = edit(reel, tmp_path / "same", *operations), open_reel(reel)
    view = original.manifest.cameras[0]
    assert psnr(make_image(same, 4, view), make_image(original, 4, view)) > 36
    np.testing.assert_allclose(same.manifest.camera.viewmat, original.manifest.camera.viewmat, atol=1e-5)


def test_facts_of_the_manifest_follow(reel: Path) -> None:
    before = ReelClip(reel).outline
    after = apply_operations(ReelClip(reel), ["rotate=x,90", "scale=2", "move=1,2,3"]).outline
    place = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    np.testing.assert_allclose(after.focus, 2 * place @ before.focus + (1, 2, 3), atol=1e-6)
    np.testing.assert_allclose(after.header.up, before.header.up)
    assert after.header.near == pytest.approx(0.2)
    assert after.header.clearance.share == before.header.clearance.share
    assert after.limits is not None
    assert after.limits.distance == (2.0, 12.0)
    assert after.limits.angle == 30.0
    assert after.sound is not None
    assert after.sound.position == pytest.approx((3.0, 2.0, 3.0))
    np.testing.assert_allclose(after.header.bounds, [[-2, -1, 0], [4, 5, 6]], atol=1e-6)


def test_up_turns_the_direction_and_the_floor_with_it(reel: Path) -> None:
    after = apply_operations(ReelClip(reel), ["up=z"]).outline
    np.testing.assert_allclose(after.header.up, (0, 0, 1), atol=1e-9)
    assert after.limits is not None
    assert after.limits.floor == pytest.approx(-1.0)


def test_distance_scales_to_meters(reel: Path) -> None:
    cameras = apply_operations(ReelClip(reel), ["distance=cam00,cam01,3"]).outline.header.cameras
    assert np.linalg.norm(cameras[0].center - cameras[1].center) == pytest.approx(3.0, rel=1e-5)


def test_origin_moves_with_rotation_and_scale_only() -> None:
    header = write_header()
    turned = Similarity(np.array([np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)]), 2.0, np.array([5.0, 0, 0])).header(
        header
    )
    np.testing.assert_allclose(turned.origin, (-400, 200, 600), atol=1e-9)


def write_header() -> ReelHeader:
    """Return a header with a distant origin."""
    header = ReelHeader(
        fps=30,
        group_length=1,
        overlap=0,
        sh_degree=0,
        bounds=np.array([[-1.0, -1, -1], [1, 1, 1]]),
        up=np.array([0.0, 0, 1]),
        camera=camera("a", 0),
        cameras=[],
    )
    return replace(header, origin=np.array([100.0, 200.0, 300.0]))


def test_floor_comes_to_zero(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    floor = rng.uniform(-2, 2, (400, 3)) * (1, 0, 1) + (0, 1.3, 0)
    table = rng.uniform(-0.3, 0.3, (60, 3)) * (1, 0, 1) + (0, 0.7, 0)
    noise = rng.uniform(-2, 2, (50, 3))
    means = np.concatenate([floor, table, noise])
    flat = np.tile([0.1, 0.005, 0.1], (len(means), 1))
    quats, sh = np.tile([1.0, 0, 0, 0], (len(means), 1)), np.zeros((len(means), 1, 3))
    points = Gaussians(means, quats, flat, np.full(len(means), 0.9), sh)
    above = facing("a", np.array([0.0, -3, -3]), np.array([0, 0.7071, 0.7071]), 50, 100, 100, (0, -1, 0))
    writer = new_writer(tmp_path / "reel", cameras=[above, above], camera=above, sh_degree=0)
    writer.add_layer(0, 0, points)
    writer.add_group(new_group(0, 0, len(points)))
    writer.finish()
    moved = edit(tmp_path / "reel", tmp_path / "moved", "floor")
    heights = moved.at(0).means @ moved.manifest.up
    assert np.median(np.abs(heights[np.argsort(heights)[60:300]])) < 0.02
    assert moved.manifest.camera.center @ moved.manifest.up == pytest.approx(3 + 1.3, abs=0.05)
