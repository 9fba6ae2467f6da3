"""Parts of large layers: their sizes, the choice of their points, and reels that hold them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from splatreel.codec import encoder
from splatreel.codec.encoder import FIRST, ReelEncoder, part_sizes, split_layer
from splatreel.codec.group_file import decode_layer_to_edit, decode_parts, encode_layer
from splatreel.codec.inspection import verify_reel
from splatreel.codec.predictive.precision import SHAPE
from splatreel.codec.reader import ReelReader
from splatreel.config import EncodeConfig
from splatreel.edit.clip_writer import write_clip
from splatreel.edit.reel_clip import ReelClip
from splatreel.play.timeline import Timeline
from splatreel.scene.camera import facing
from splatreel.scene.gaussians import Gaussians
from tests.codec.reels import CONFIG, QUICK, new_group, new_writer, points
from tests.golden import weights

CAMERA = facing("a", np.array([0.0, 0, -4]), np.array([0.0, 0, 1]), 100, 160, 90)


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Split layers of more than 40 points."""
    monkeypatch.setattr(encoder, "FIRST", 20)


def test_small_layer_has_one_part() -> None:
    for count in (0, 1, FIRST, 2 * FIRST):
        assert part_sizes(count) == [count]
    assert part_sizes(2 * FIRST + 1) == [FIRST, FIRST + 1]


def test_parts_grow() -> None:
    assert part_sizes(13 * FIRST) == [FIRST, 4 * FIRST, 8 * FIRST]
    for count in np.geomspace(1, 1e6, 60).astype(int).tolist():
        sizes = part_sizes(count)
        assert sum(sizes) == count
        assert all(a <= 2 * b and b <= 8 * a for a, b in pairwise(sizes))


@pytest.mark.usefixtures("small_parts")
def test_large_opaque_important_points_come_first() -> None:
    some = points(100, seed=3)
    alike = replace(some, scales=np.full((100, 3), 0.01, np.float32), opacities=np.full(100, 0.5, np.float32))
    none = np.zeros((100, 3), np.int64)
    for change in ("large", "opaque", "important"):
        chosen = np.arange(100) % 5 == 2
        classes = np.where(chosen[:, None] | (change != "important"), none, none + 1)
        scales = np.where(chosen[:, None] & (change == "large"), 0.05, alike.scales)
        opacities = np.where(chosen & (change == "opaque"), 0.9, alike.opacities)
        parts = split_layer(replace(alike, scales=scales, opacities=opacities), classes, ())
        assert np.array_equal(parts[0], np.flatnonzero(chosen)), change
        assert sorted(np.concatenate(parts)) == list(range(100))


@pytest.mark.usefixtures("small_parts")
def test_areas_are_those_in_the_images() -> None:
    """Near points come first, and points that no camera sees come last."""
    some = replace(points(60), scales=np.full((60, 3), 0.01, np.float32), opacities=np.full(60, 0.5, np.float32))
    means = np.zeros((60, 3), np.float32)
    means[:, 2] = np.linspace(0, 2, 60)
    means[:20, 2] = -6  # behind the camera
    parts = split_layer(replace(some, means=means), np.zeros((60, 3), np.int64), [CAMERA])
    assert [part.tolist() for part in parts] == [list(range(20, 40)), [*range(20), *range(40, 60)]]


@pytest.mark.usefixtures("small_parts")
def test_equal_points_are_in_one_part() -> None:
    same = points(1)[np.zeros(100, np.int64)]
    assert [len(part) for part in split_layer(same, np.zeros((100, 3), np.int64), [CAMERA])] == [100]


@pytest.mark.usefixtures("small_parts")
def test_parts_hold_all_points_with_the_precision_of_one_file() -> None:
    some, importance = points(400, seed=1), weights(400)
    encoder = ReelEncoder(QUICK, [CAMERA])
    files, order = encoder.layer(0, 0, some, importance)
    assert len(files) == 3
    assert sorted(order) == list(range(400))
    single, single_order = encode_layer(0, 0, some, encoder.config, importance)
    decoded, (alone, precision) = decode_parts(files, "layer"), decode_layer_to_edit(single, "layer")
    assert precision is not None
    same = np.argsort(single_order)[order]
    # The parts share the grid of positions. Other values are rounded to the same steps, from other predictions.
    np.testing.assert_array_equal(decoded.means, alone.means[same])
    step = precision.steps["opacities"] * 2.0 ** precision.classes[same, SHAPE]
    assert (np.abs(decoded.opacities - some.opacities[order]) <= step).all()
    for file in files:
        again = decode_layer_to_edit(file, "part")[1]
        assert again is not None
        assert again.steps == precision.steps
    assert sum(map(len, files)) < 1.5 * len(single)  # every file has a header of its own


@pytest.mark.usefixtures("small_parts")
def test_parts_do_not_depend_on_the_order_of_the_points() -> None:
    some, importance, shuffled = points(200), weights(200), np.random.default_rng(0).permutation(200)
    encoder = ReelEncoder(QUICK, [CAMERA])
    files, order = encoder.layer(0, 0, some, importance)
    others, other_order = encoder.layer(0, 0, some[shuffled], importance[shuffled])
    assert files == others
    assert np.array_equal(order, shuffled[other_order])


@pytest.mark.usefixtures("small_parts")
def test_layer_in_the_papers_coding_has_one_part() -> None:
    assert len(ReelEncoder(CONFIG).layer(0, 0, points(100))[0]) == 1


def write_parts(path: Path, resume: bool = False) -> np.ndarray:
    """Write a reel of 100 static points at group 0 and 10 at group 1. Return the points that are alive at group 1, in order."""
    writer = new_writer(path, config=QUICK)
    first, order = writer.add_layer(0, 0, points(100))
    alive = points(100).means[order, 0] > 0
    writer.add_group(new_group(0, 5, np.ones(100, bool)))
    if resume:
        writer = new_writer(path, config=QUICK, resume=True)
    second, _ = writer.add_layer(1, 2, points(10, seed=1))
    writer.add_group(new_group(1, 5, np.concatenate([alive, np.ones(10, bool)])))
    writer.finish()
    return Gaussians.concatenate([first[alive], second]).means


@pytest.mark.usefixtures("small_parts")
@pytest.mark.parametrize("resume", [False, True])
def test_reel_of_parts_shows_the_points_that_are_alive(tmp_path: Path, resume: bool) -> None:
    means = write_parts(tmp_path, resume)
    reel = ReelReader(tmp_path)
    assert reel.manifest.version == 2
    uris = [(layer.uri, layer.group, layer.points, layer.until) for layer in reel.manifest.layers]
    assert uris == [
        ("layers/0000.safetensors", 0, 20, None),
        ("layers/0000.1.safetensors", 0, 80, None),
        ("layers/0001.safetensors", 1, 10, None),
    ]
    static, _ = reel.static(1)
    np.testing.assert_array_equal(static[reel.group(1).alive].means, means)
    np.testing.assert_array_equal(Timeline(reel).at(0.3).means[: len(means)], means)
    assert verify_reel(tmp_path).points == 120


@pytest.mark.usefixtures("small_parts")
def test_edit_keeps_parts(tmp_path: Path) -> None:
    write_parts(tmp_path / "reel")
    write_clip(ReelClip(tmp_path / "reel"), tmp_path / "edited", lambda _: None)
    before, after = (ReelReader(tmp_path / name) for name in ("reel", "edited"))
    assert [layer.sha256 for layer in before.manifest.layers] == [layer.sha256 for layer in after.manifest.layers]
    np.testing.assert_array_equal(before.group(1).alive, after.group(1).alive)


def test_all_parts_are_retired_together(tmp_path: Path, small_parts: None) -> None:
    writer = new_writer(tmp_path, config=EncodeConfig(coarseness=1.0), page=1)
    for index in range(4):
        if index % 2 == 0:
            writer.add_layer(index, 2 * index, points(60, seed=index), until=index + 2)
        writer.add_group(new_group(index, 3, 60))
    writer.finish()
    reel = ReelReader(tmp_path)
    assert [page.groups for page in reel.manifest.pages] == [1, 1, 1]
    assert [len(reel.static(index)[0]) for index in range(4)] == [60] * 4
    assert verify_reel(tmp_path).layers == 4
