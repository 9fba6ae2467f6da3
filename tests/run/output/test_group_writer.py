"""Writing of groups from checkpoints: importance is reused, and threads do not change the result."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.base.progress import Silent
from splatreel.codec import encoder
from splatreel.codec.header import ReelHeader
from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader
from splatreel.config import EncodeConfig
from splatreel.method.encode import compression
from splatreel.run.output import group_writer
from splatreel.run.output.group_writer import GroupWriter, Region, open_writer
from splatreel.run.output.reencode import reencode
from splatreel.run.store import Store, StoredGroup, StoredLayer
from splatreel.scene.volumes import Sphere
from tests.codec.reels import new_group, points
from tests.files import contents
from tests.golden import camera, weights

GROUPS = 4


@pytest.fixture
def work(tmp_path: Path) -> Path:
    """Create checkpoints of groups with 40 dynamic points; 30 static points are born at the first and 20 at the third."""
    store = Store(tmp_path / "work")
    bounds, up = np.array([[-1.0, -1, -1], [1, 1, 1]]), np.array([0.0, -1, 0])
    views = {"camera": camera("start", 0), "cameras": [camera("a", 1)]}
    store.save_header(ReelHeader(fps=10, group_length=2, overlap=1, sh_degree=1, bounds=bounds, up=up, **views))
    static = 0
    for index in range(GROUPS):
        born = {0: 30, 2: 20}.get(index, 0)
        static += born
        if born:
            layer = points(born, seed=index)
            store.group(index).save_layer(StoredLayer(layer, layer, weights(born)))
        alive = np.random.default_rng(index).random(static) > 0.3
        store.group(index).save_group(StoredGroup(new_group(index, 40, alive), weights(40)))
    return store.work


@pytest.fixture(autouse=True)
def no_images(monkeypatch: pytest.MonkeyPatch) -> None:
    def weigh(*_: object) -> None:
        raise AssertionError("the run has measured the importance already")

    monkeypatch.setattr(compression, "weigh", weigh)


@pytest.mark.parametrize("workers", [1, 3])
def test_write_all_equals_writing_one_by_one(
    work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int
) -> None:
    monkeypatch.setattr(group_writer.os, "cpu_count", lambda: workers)
    config = EncodeConfig(renditions=("high", "low"))
    reencode(work, tmp_path / "threaded", config, Silent())
    writer = open_writer(Store(work), tmp_path / "single", config, resume=False)
    one = GroupWriter(writer, Store(work))
    for index in range(GROUPS):
        one.write(index)
    writer.finish()
    assert contents(tmp_path / "threaded") == contents(tmp_path / "single")
    found = verify_reel(tmp_path / "threaded")
    assert (found.groups, found.layers, found.points) == (GROUPS, 2, 50 + 40 * GROUPS)


@pytest.mark.parametrize("kind", ["parts", "region"])
def test_continued_reel_equals_an_uninterrupted_one(
    work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """The alive flags of later groups follow the points of the layers that the reel holds already."""
    if kind == "parts":
        monkeypatch.setattr(encoder, "FIRST", 8)
    else:
        half = Region(Sphere(np.array([0.2, 0.0, 0.0]), 1.0))
        monkeypatch.setattr(group_writer, "region_of", lambda *_: half)
    reels = tmp_path / "whole", tmp_path / "continued"
    for reel, stops in zip(reels, ([], [1, 3]), strict=True):
        first = 0
        for end in [*stops, GROUPS]:
            writer = open_writer(Store(work), reel, EncodeConfig(), resume=first > 0)
            groups = GroupWriter(writer, Store(work))
            for index in range(first):
                groups.skip(index)
            for index in range(first, end):
                groups.write(index)
            first = end
        writer.finish()
    assert contents(reels[0]) == contents(reels[1])
    assert len(ReelReader(reels[0]).manifest.layers) == (4 if kind == "parts" else 2)


def test_checkpoint_of_a_layer_holds_the_files_of_its_parts(tmp_path: Path) -> None:
    store = Store(tmp_path).group(0)
    for files in ((b"one",), (b"one", b"two", b"three")):
        store.save_encoded_layer(files)
        assert store.encoded_layer() == files


def test_failed_group_keeps_earlier_groups(work: Path, tmp_path: Path) -> None:
    broken = Store(work).group(2)
    stored = broken.group()
    stored.group.dx[1, 3] = np.nan
    broken.save_group(stored)
    with pytest.raises(ReelError, match="NaN or infinity"):
        reencode(work, tmp_path / "reel", EncodeConfig(), Silent())
    writer = open_writer(Store(work), tmp_path / "reel", EncodeConfig(), resume=True)
    assert 1 <= len(writer.manifest.groups) <= 2
