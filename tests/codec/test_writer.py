"""Writing reels: decoded results, atomic updates, resuming, a full disk."""

import dataclasses
import hashlib
import json

import numpy as np
import pytest

from splatreel.base.errors import ReelError, StorageError
from splatreel.codec.group_file import encode_layer
from splatreel.codec.inspection import verify_reel
from splatreel.codec.presentation import Poster, Presentation
from splatreel.codec.reader import ReelReader
from splatreel.config import EncodeConfig
from tests.codec.reels import new_group, new_writer, points, write_reel
from tests.files import contents
from tests.golden import camera


def assert_same(a, b):
    for name in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_writer_returns_what_readers_decode(tmp_path):
    """`add_layer` and `add_group` return the data that a reader gets, and the order maps it to the input."""
    writer = new_writer(tmp_path)
    static = points(30)
    layer, order = writer.add_layer(0, 0, static)
    np.testing.assert_allclose(layer.means, static.means[order], atol=1e-5)
    np.testing.assert_allclose(layer.opacities, static.opacities[order], atol=3e-3)
    alive = np.arange(30) % 3 > 0
    group = writer.add_group(new_group(0, 12, alive))
    writer.finish()
    reel = ReelReader(tmp_path)
    assert_same(reel.layer(0), layer)
    assert_same(reel.group(0).dynamic, group.dynamic)
    np.testing.assert_array_equal(reel.group(0).dx, group.dx)
    np.testing.assert_array_equal(reel.group(0).dq, group.dq)
    np.testing.assert_array_equal(reel.group(0).alive, alive)


def test_offsets_follow_their_points(tmp_path):
    """Each decoded point has the motion of its input point."""
    group = new_group(0, 200, 0)
    decoded = new_writer(tmp_path).add_group(group)
    distance = np.linalg.norm(decoded.dynamic.means[:, None] - group.dynamic.means, axis=-1)
    source = distance.argmin(1)
    assert sorted(source) == list(range(200))
    np.testing.assert_allclose(decoded.dx, group.dx[:, source], atol=0.01)


def test_manifest_grows_until_finished(tmp_path):
    writer = new_writer(tmp_path)
    writer.add_layer(0, 0, points(5))
    assert not (tmp_path / "manifest.json").exists()
    writer.add_group(new_group(0, 4, 5))
    live = json.loads((tmp_path / "manifest.json").read_text())
    assert (live["live"], live["frames"], len(live["layers"])) == (True, 3, 1)
    writer.add_group(new_group(1, 4, 5))
    writer.finish()
    final = ReelReader(tmp_path).manifest
    assert (final.live, final.frames, len(final.layers), len(final.groups)) == (False, 5, 1, 2)
    assert [entry.bytes for entry in final.groups] == [len((tmp_path / e.uri).read_bytes()) for e in final.groups]
    data = (tmp_path / final.layers[0].uri).read_bytes()
    assert final.layers[0].sha256 == hashlib.sha256(data).hexdigest()


def test_reel_bytes_are_reproducible(tmp_path):
    assert contents(write_reel(tmp_path / "a")) == contents(write_reel(tmp_path / "b"))


@pytest.mark.parametrize(("static", "dynamic", "frames"), [(0, 0, 1), (0, 3, 1), (3, 0, 4), (1, 1, 1)])
def test_smallest_groups_round_trip(tmp_path, static, dynamic, frames):
    writer = new_writer(tmp_path)
    writer.add_layer(0, 0, points(static))
    writer.add_group(new_group(0, dynamic, static, frames=frames))
    writer.finish()
    assert verify_reel(tmp_path).points == static + dynamic
    group = ReelReader(tmp_path).group(0)
    assert (group.frames, len(group.dynamic), len(group.alive)) == (frames, dynamic, static)


def test_resume_continues_after_the_last_group(tmp_path):
    whole = write_reel(tmp_path / "whole", groups=3)
    writer = new_writer(tmp_path / "cut")
    writer.add_layer(0, 0, points(20, seed=0))
    writer.add_group(new_group(0, 15, 20))
    writer.add_layer(1, 2, points(10, seed=1))  # and here it crashes
    writer = new_writer(tmp_path / "cut", resume=True)
    assert len(writer.manifest.groups) == 1
    writer.add_layer(1, 2, points(10, seed=1))
    writer.add_group(new_group(1, 15, 30))
    writer = new_writer(tmp_path / "cut", resume=True)
    writer.add_layer(2, 4, points(0))
    writer.add_group(new_group(2, 15, 30))
    writer.finish()
    assert contents(whole) == contents(tmp_path / "cut")


def test_adding_an_earlier_group_drops_the_later_ones(tmp_path):
    path = write_reel(tmp_path, groups=3)
    writer = new_writer(path, resume=True)
    writer.add_layer(1, 2, points(7, seed=9))
    manifest = ReelReader(path).manifest
    assert (len(manifest.groups), len(manifest.layers), manifest.live) == (1, 1, True)
    assert verify_reel(path).groups == 1
    writer.add_group(new_group(1, 6, 27))
    assert verify_reel(path).points == 20 + 15 + 7 + 6
    assert sorted(p.name for p in (path / "groups").iterdir()) == ["0000.safetensors", "0001.safetensors"]


@pytest.mark.parametrize("uri", ["layers/0001.safetensors", "groups/0001.safetensors"])
def test_resume_keeps_only_intact_groups(tmp_path, uri):
    path = write_reel(tmp_path, groups=3)
    file = path / uri
    file.write_bytes(file.read_bytes()[:-1])
    assert len(new_writer(path, resume=True).manifest.groups) == 1
    assert verify_reel(path).groups == 1
    (path / "groups" / "0000.safetensors").unlink()
    assert new_writer(path, resume=True).manifest.groups == ()
    assert not (path / "manifest.json").exists()


@pytest.mark.parametrize("uri", ["layers/0001.safetensors", "groups/0001.safetensors"])
def test_resume_drops_damaged_files_of_the_right_length(tmp_path, uri):
    path = write_reel(tmp_path, groups=3)
    data = bytearray((path / uri).read_bytes())
    data[-5] ^= 1
    (path / uri).write_bytes(data)
    assert len(new_writer(path, resume=True).manifest.groups) == 1
    assert verify_reel(path).groups == 1


def test_resume_drops_damaged_images(tmp_path):
    writer = new_writer(tmp_path)
    writer.add_group(new_group(0, 5, 0))
    poster = Poster(writer.write_asset("poster.jpg", b"an image"), 4, 3)
    writer.present(Presentation(title="A title", poster=poster))
    (tmp_path / "poster.jpg").write_bytes(b"An image")
    presentation = new_writer(tmp_path, resume=True).manifest.presentation
    assert (presentation.title, presentation.poster) == ("A title", None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fps": 1e-300}, "fps = 1e-300"),
        ({"near": 0.0}, "near = 0"),
        ({"near": float("nan")}, "NaN"),
        ({"up": np.array([np.inf, 0, 0])}, "infinity"),
        ({"cameras": [camera("a" * 300, 1)]}, "camera of the name"),
        ({"background": (2.0, 0, 0)}, "background"),
    ],
)
def test_invalid_header_is_refused_before_writing(tmp_path, change, message):
    with pytest.raises(ReelError, match=message):
        new_writer(tmp_path / "reel", **change)
    assert not (tmp_path / "reel").exists()


@pytest.mark.parametrize("unit", [1e-12, 1e12])
def test_scenes_of_any_scale_round_trip(tmp_path, unit):
    config = EncodeConfig()
    writer = new_writer(tmp_path, near=0.01 * unit, bounds=unit * np.array([[-1.0, -1, -1], [1, 1, 1]]), config=config)
    one, group = points(30), new_group(0, 20, 30)
    still = dataclasses.replace(one, means=one.means * unit, scales=one.scales * unit)
    moving = dataclasses.replace(group.dynamic, means=group.dynamic.means * unit, scales=group.dynamic.scales * unit)
    writer.add_layer(0, 0, still)
    writer.add_group(dataclasses.replace(group, dynamic=moving, dx=group.dx * unit))
    writer.finish()
    verify_reel(tmp_path)
    reel, order = ReelReader(tmp_path), encode_layer(0, 0, still, config)[1]
    assert np.abs(reel.layer(0).means / unit - one.means[order]).max() < 0.1
    assert 0 < np.abs(reel.group(0).dx).max() / unit < 10


def test_without_resume_the_old_reel_is_dropped(tmp_path):
    new_writer(write_reel(tmp_path))
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("alive", [0, 19, 21])
def test_wrong_alive_length_is_refused(tmp_path, alive):
    writer = new_writer(tmp_path)
    writer.add_layer(0, 0, points(20))
    with pytest.raises(ReelError, match=f"{alive} static points.* hold 20"):
        writer.add_group(new_group(0, 3, alive))


def test_groups_out_of_order_are_refused(tmp_path):
    writer = new_writer(tmp_path)
    with pytest.raises(ReelError, match="the next one is 0"):
        writer.add_group(new_group(1, 3, 0))
    with pytest.raises(ReelError, match="without a group"):
        writer.finish()


def test_full_disk_leaves_a_valid_reel(tmp_path, monkeypatch):
    writer = new_writer(tmp_path)
    writer.add_layer(0, 0, points(20))
    writer.add_group(new_group(0, 5, 20))

    def full(_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        with pytest.raises(StorageError, match=r"0001\.safetensors.*No space left"):
            writer.add_group(new_group(1, 5, 20))
    assert verify_reel(tmp_path).groups == 1
    writer.add_group(new_group(1, 5, 20))
    assert verify_reel(tmp_path).groups == 2
