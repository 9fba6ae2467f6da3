"""Gaussians and images of a reel at a time, especially in the overlap of two groups."""

import shutil
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.reader import ReelReader
from splatreel.kernels.image import render_image
from splatreel.play.timeline import open_reel
from splatreel.scene.gaussians import Gaussians
from tests.codec.reels import edit_manifest, new_group, new_writer, points
from tests.golden import PREDICTIVE

FPS, FIRST, OVERLAP = 10, 4, 2


@pytest.fixture(scope="module")
def reel(tmp_path_factory):
    """Two groups of 6 frames from frames 0 and 4, overlap 2: of 6 static points one dies, of 4 born later all live."""
    path = tmp_path_factory.mktemp("reel")
    writer = new_writer(path, overlap=OVERLAP)
    writer.add_layer(0, 0, points(6, seed=1))
    writer.add_group(new_group(0, 5, 6, frames=6, first_frame=0))
    writer.add_layer(1, FIRST, points(4, seed=2))
    alive = np.ones(10, bool)
    alive[2] = False
    writer.add_group(new_group(1, 7, alive, frames=6, first_frame=FIRST))
    writer.finish()
    return path


def test_timeline_shows_first_frame(reel):
    timeline, reader = open_reel(reel), ReelReader(reel)
    shown = timeline.at(0)
    expected = Gaussians.concatenate([reader.layer(0), reader.group(0).at(0)])
    np.testing.assert_array_equal(shown.means, expected.means)
    np.testing.assert_array_equal(shown.opacities, expected.opacities)
    assert (timeline.frames, timeline.fps, timeline.duration) == (10, 10, 1.0)


def test_moment_is_an_immutable_dataclass(reel):
    moment = open_reel(reel).at(FIRST / FPS)
    halved = replace(moment, opacities=moment.opacities / 2)
    np.testing.assert_array_equal(halved.is_static, moment.is_static)
    np.testing.assert_array_equal(moment[moment.is_static].means, moment.means[moment.is_static])
    with pytest.raises(FrozenInstanceError):
        moment.light = np.zeros(3)  # pyright: ignore[reportAttributeAccessIssue]


def test_render_follows_manifest(tmp_path):
    shutil.copytree(PREDICTIVE, tmp_path / "reel")
    edit_manifest(tmp_path / "reel", lambda manifest: manifest.update(near=3.5))
    timeline = open_reel(tmp_path / "reel")
    camera, gaussians = timeline.manifest.camera, timeline.at(0.1)
    image = timeline.render(gaussians, camera)
    np.testing.assert_array_equal(image, render_image(gaussians, camera, near=3.5, antialias=True))
    assert np.abs(image - render_image(gaussians, camera, near=3.5)).mean() > 1e-3
    assert np.abs(image - render_image(gaussians, camera, antialias=True)).mean() > 1e-3


def test_background_is_scaled_by_light(tmp_path):
    """The second group of this reel grows darker and redder."""
    shutil.copytree(PREDICTIVE, tmp_path / "reel")
    edit_manifest(tmp_path / "reel", lambda manifest: manifest.update(background=[0.2, 0.4, 0.6]))
    timeline = open_reel(tmp_path / "reel")
    camera = timeline.manifest.camera
    for frame, light in ((1, np.ones(3)), (13, timeline.reel.group(1).light[7])):
        shown = timeline.at(frame / timeline.fps)
        image = timeline.render(shown, camera)
        background = tuple(np.array([0.2, 0.4, 0.6]) * light)
        np.testing.assert_allclose(image, render_image(shown, camera, antialias=True, background=background), atol=1e-6)
        np.testing.assert_allclose(image[0, 0], background, atol=1e-6)


@pytest.mark.parametrize("frame", [1.0, 7.0])
def test_clearance_hides_static_points_near_camera(reel, tmp_path, frame):
    """From a depth among the static points, some of them are gone, and every moving one is there."""
    shutil.copytree(reel, tmp_path / "reel")
    before = open_reel(reel)
    camera, shown = before.manifest.camera, before.at(frame / FPS)
    depths = shown.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    limit = float(np.sort(depths[shown.is_static])[len(shown) // 4 :][:2].mean())  # between two points
    focus = camera.center + 2 * limit * camera.viewmat[2, :3]
    edit_manifest(
        tmp_path / "reel", lambda manifest: manifest.update(clearance={"focus": focus.tolist(), "share": 0.5})
    )
    after = open_reel(tmp_path / "reel")
    assert after.manifest.clearance.depth(camera) == pytest.approx(limit, rel=1e-5)
    kept = ~shown.is_static | (depths > limit)
    assert 0.2 < kept[shown.is_static].mean() < 0.8
    moment = after.at(frame / FPS)
    np.testing.assert_array_equal(moment.means, shown.means)
    np.testing.assert_array_equal(after.render(moment, camera), before.render(shown[kept], camera))


def test_timeline_interpolates_between_frames(reel):
    group = ReelReader(reel).group(0)
    shown = open_reel(reel).at(0.15)
    np.testing.assert_allclose(shown.means[6:], group.dynamic.means + (group.dx[1] + group.dx[2]) / 2, atol=1e-6)
    assert len(shown) == 11


@pytest.mark.parametrize(("frame", "weight"), [(4.0, 0.0), (4.5, 0.15625), (5.0, 0.5)])
def test_timeline_overlap_fades_points(reel, frame, weight):
    """Static points alive in both groups stay; the rest of the old group leaves as the rest of the new one comes."""
    reader = ReelReader(reel)
    shown = open_reel(reel).at(frame / FPS)
    old, new = reader.group(0).at(frame), reader.group(1).at(frame - FIRST)
    stays, dies = reader.layer(0)[np.arange(6) != 2], reader.layer(0)[2:3]
    expected = Gaussians.concatenate([stays, dies, old, reader.layer(1), new])
    weights = np.repeat([1, 1 - weight, 1 - weight, weight, weight], [5, 1, 5, 4, 7])
    np.testing.assert_array_equal(shown.is_static, np.repeat([True, True, False, True, False], [5, 1, 5, 4, 7]))
    np.testing.assert_array_equal(shown.means, expected.means)
    np.testing.assert_allclose(shown.opacities, 1 - (1 - expected.opacities) ** weights, atol=2e-4)


@pytest.mark.parametrize(("frame", "weight"), [(4.0, 0.0), (4.5, 0.15625), (5.0, 0.5)])
def test_render_blends_images_between_groups(reel, frame, weight):
    """The images of the old and the new group are blended, each with its own static points."""
    reader, timeline = ReelReader(reel), open_reel(reel)
    camera = replace(timeline.manifest.camera, width=64, height=48)
    six, four = reader.layer(0), reader.layer(1)
    old = Gaussians.concatenate([six, reader.group(0).at(frame)])
    new = Gaussians.concatenate([six[np.arange(6) != 2], four, reader.group(1).at(frame - FIRST)])
    a, b = (render_image(points, camera) for points in (old, new))
    assert np.abs(a - b).max() > 0.1
    shown = timeline.at(frame / FPS)
    np.testing.assert_allclose(timeline.render(shown, camera), (1 - weight) * a + weight * b, atol=1e-5)


def test_light_of_new_group_applies_to_everything(reel, tmp_path):
    """The same reel with a second group whose light changes: the same points, only brighter, the ones that leave as well."""
    reader = ReelReader(reel)
    light = np.linspace((1, 0.5, 0.25), (2, 1, 0.5), 6, dtype=np.float32)
    writer = new_writer(tmp_path, overlap=OVERLAP)
    writer.add_layer(0, 0, points(6, seed=1))
    writer.add_group(new_group(0, 5, 6, frames=6, first_frame=0))
    writer.add_layer(1, FIRST, points(4, seed=2))
    writer.add_group(replace(new_group(1, 7, reader.group(1).alive, frames=6, first_frame=FIRST), light=light))
    writer.finish()
    lit, plain = open_reel(tmp_path), open_reel(reel)
    camera = replace(plain.manifest.camera, width=64, height=48)
    for frame, factor in ((3, np.ones(3)), (4.5, (light[0] + light[1]) / 2), (7, light[3])):
        shown, before = lit.at(frame / FPS), plain.at(frame / FPS)
        np.testing.assert_array_equal(shown.opacities, before.opacities)
        np.testing.assert_allclose(lit.render(shown, camera), plain.render(before, camera) * factor, atol=2e-3)


def test_timeline_shows_new_group_after_overlap(reel):
    shown = open_reel(reel).at((FIRST + OVERLAP) / FPS)
    assert len(shown) == 5 + 4 + 7


def test_timeline_shows_old_group_before_next(reel):
    assert len(open_reel(reel).at(0.3999)) == 11


@pytest.mark.parametrize(("outside", "inside"), [(-3, 0), (0.9, 0.9), (1.0, 0.9), (1e9, 0.9), (float("inf"), 0.9)])
def test_timeline_clamps_times(reel, outside, inside):
    timeline = open_reel(reel)
    np.testing.assert_array_equal(timeline.at(outside).means, timeline.at(inside).means)


def test_timeline_refuses_nan(reel):
    with pytest.raises(ValueError, match="NaN"):
        open_reel(reel).at(float("nan"))


def test_timeline_without_overlap_or_points(tmp_path):
    writer = new_writer(tmp_path, overlap=0)
    writer.add_group(new_group(0, 0, 0, frames=2))
    writer.add_layer(1, 2, points(3))
    writer.add_group(new_group(1, 0, 3, frames=1))
    timeline = open_reel(tmp_path)
    assert [len(timeline.at(seconds)) for seconds in (0, 0.1, 0.2, 5)] == [0, 0, 3, 3]


def test_timeline_of_live_reel_without_groups_raises(tmp_path, reel):
    (tmp_path / "manifest.json").write_bytes((reel / "manifest.json").read_bytes())
    edit_manifest(tmp_path, lambda d: d.update(live=True, groups=[], layers=[], frames=0))
    with pytest.raises(ReelError, match="no group yet"):
        open_reel(tmp_path).at(0)


def test_a_reel_is_a_sequence_of_frames(reel):
    timeline = open_reel(reel)
    assert len(timeline) == len(list(timeline)) == timeline.frames == 10
    for frame in (0, 3, 4, 9):
        np.testing.assert_array_equal(timeline[frame].means, timeline.at(frame / FPS).means)
    np.testing.assert_array_equal(timeline[-1].means, timeline[9].means)
    assert [len(moment) for moment in timeline[7:9]] == [len(timeline[7]), len(timeline[8])]
    for number in (10, -11):
        with pytest.raises(IndexError, match="has 10 frames"):
            timeline[number]


def test_a_reel_closes_and_describes_itself(reel, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "reel").symlink_to(reel)
    with open_reel(tmp_path / "run") as timeline:  # as the command line takes the output folder of a run
        assert repr(timeline) == f"Timeline({str(tmp_path / 'run' / 'reel')!r}, 10 frames at 10 a second, 1.00 s)"
        first = timeline[0]
        assert repr(first) == f"Moment({len(first)} points, SH degree {first.sh_degree})"
    assert not timeline.reel._groups
    pytest.importorskip("torch")
    tensors = timeline.to_torch(0.0)
    np.testing.assert_array_equal(tensors["means"].numpy(), first.means)
    assert list(tensors) == ["means", "quats", "scales", "opacities", "sh"]
