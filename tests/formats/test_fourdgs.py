"""Scenes in the .4dgs format, written by its own library."""

import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.formats.fourdgs import FourdgsScene
from splatreel.formats.fourdgs_writer import write_fourdgs
from splatreel.formats.registry import Placement
from splatreel.importing.frames import open_frames
from splatreel.scene import rotations
from splatreel.scene.gaussians import C0, Gaussians

fourdgs = pytest.importorskip("fourdgs")
N = 12


def write_scene(path: Path) -> Any:
    """Write a scene of 2 seconds: points move along x, and the last of them is there in the second second only."""
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(N, 4))
    points = fourdgs.GaussianSet(
        positions=rng.uniform(-1, 1, (N, 3)).astype(np.float32),
        scales=rng.uniform(0.02, 0.1, (N, 3)).astype(np.float32),
        rotations=(turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32),
        colors=rng.uniform(0.1, 0.9, (N, 4)).astype(np.float32),
        motions=np.tile(np.array([0.5, 0, 0], np.float32), (N, 1)),
        mu_t=np.ones(N, np.float32),
        sigma_t=np.full(N, np.inf, np.float32),
        win_lo=np.where(np.arange(N) < N - 1, 0.0, 1.0),
        win_hi=np.full(N, 2.0),
    )
    fourdgs.write(str(path), points, 2.0)
    return points


def test_scene_is_sampled_in_time(tmp_path: Path) -> None:
    given = write_scene(tmp_path / "scene.4dgs")
    frames = open_frames(tmp_path / "scene.4dgs", fps=10)
    assert (len(frames), frames.fps, len(frames.read(3)), len(frames.read(15))) == (20, 10, N - 1, N)
    assert len(open_frames(tmp_path / "scene.4dgs")) == 60
    points = frames.read(15)
    order = [int(np.abs(given.colors[:, :3] - (sh * C0 + 0.5)).sum(1).argmin()) for sh in points.sh[:, 0]]
    expected = given.positions[order] + np.array([0.5, 0, 0]) * (1.55 - 1.0)
    np.testing.assert_allclose(points.means, expected, atol=5e-3)
    np.testing.assert_allclose(points.opacities, given.colors[order, 3], atol=0.01)
    np.testing.assert_allclose(points.scales, given.scales[order], rtol=0.05)
    cosines = (points.quats[:, [1, 2, 3, 0]] * given.rotations[order]).sum(1)
    np.testing.assert_allclose(np.abs(cosines), 1, atol=0.01)


class Flight:
    """A film of 40 points, 10 frames a second. Some fly straight on, and one of them turns back in the middle."""

    placement = Placement(np.array([1.0, 0, 0, 0]), None, False)
    seconds = tuple(np.arange(20) / 10)

    def __init__(self, view_dependent: float) -> None:
        rng = np.random.default_rng(0)
        sh = np.concatenate([rng.uniform(-1, 1, (40, 1, 3)), rng.normal(0, view_dependent, (40, 15, 3))], 1)
        quats = rotations.normalize(rng.normal(size=(40, 4)))
        self.points = Gaussians(rng.uniform(-1, 1, (40, 3)), quats, np.full((40, 3), 0.05), np.full(40, 0.8), sh)
        self.velocity = np.where(np.arange(40) < 10, 0.5, 0.0)

    def identified(self, seconds: float) -> tuple[Gaussians, np.ndarray]:
        way = self.velocity * seconds
        way[0] -= max(seconds - 1, 0)
        moved = replace(self.points, means=self.points.means + way[:, None] * [1, 0, 0])
        order = np.random.default_rng(int(seconds * 10)).permutation(40)
        return moved[order], order.astype(np.int64) + (1 << 62)

    def at(self, seconds: float) -> Gaussians:
        return self.identified(seconds)[0]

    def __iter__(self) -> Iterator[Gaussians]:
        return map(self.at, self.seconds)


def test_straight_paths_are_one_row_and_turns_begin_another(tmp_path: Path) -> None:
    path, film = tmp_path / "scene.4dgs", Flight(0.2)
    write_fourdgs(path, film, 10)
    scene = FourdgsScene(path, 10)
    assert 41 <= scene._scene.gaussians.count <= 42
    for frame, seconds in enumerate(film.seconds):
        points, ids = film.identified(seconds)
        expected, back = points[np.argsort(ids)], scene.read(frame)
        found = np.abs(back.sh[:, 0][None] - expected.sh[:, 0][:, None]).sum(2).argmin(1)
        assert len(np.unique(found)) == len(back) == 40
        # 0.2 of the scale of 0.05, and half a step of 0.005
        np.testing.assert_allclose(back.means[found], expected.means, atol=0.0125)
        np.testing.assert_allclose(back.sh[found], expected.sh, atol=0.04)
        assert np.abs((back.quats[found] * expected.quats).sum(1)).min() > 0.9999


def test_errors_of_view_dependent_color_cancel_between_neighbors(tmp_path: Path) -> None:
    path, film = tmp_path / "scene.4dgs", Flight(0.2)
    film.points.sh[:, 12:] = 0.001
    write_fourdgs(path, film, 10)
    error = FourdgsScene(path, 10).read(0).sh.mean(0) - film.points.sh.mean(0)
    assert np.abs(error[1:]).max() < 8 / 255 / 40 + 1e-6


@pytest.mark.parametrize(("strength", "degree"), [(0.2, 3), (0.001, 0)])
def test_view_dependent_color_below_its_steps_is_left_out(tmp_path: Path, strength: float, degree: int) -> None:
    write_fourdgs(tmp_path / "scene.4dgs", Flight(strength), 10)
    assert FourdgsScene(tmp_path / "scene.4dgs", 10).read(0).sh_degree == degree


def test_damaged_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "scene.4dgs").write_bytes(b"no scene")
    with pytest.raises(GaussiansError, match=r"scene\.4dgs: is damaged"):
        open_frames(tmp_path / "scene.4dgs")


def stream(attribute: int, count: int, channels: int, value: int = 0) -> bytes:
    """Return a stream that repeats a value, in a few bytes."""
    from fourdgs import serialization

    known = serialization.encode_stream(attribute, np.full((2, channels), value), channels=channels)
    head = serialization._STREAM_HEADER
    *start, _, length = head.unpack_from(known)
    return head.pack(*start, count, length) + known[head.size :]


def bomb(path: Path, chunks: int, count: int, before: bytes = b"") -> None:
    """Write a file whose chunks repeat one point. `before`: streams at the start of each chunk."""
    from fourdgs import opcode, records, serialization

    write_scene(path)
    parts = [serialization.MAGIC]
    for record in serialization.iter_records(path.read_bytes(), len(serialization.MAGIC)):
        if record.opcode in (opcode.HEADER, opcode.QUANTIZATION, opcode.WINDOW_TABLE):
            parts.append(serialization.put_record(record.opcode, bytes(record.content)))
    streams = [stream(name, count, opcode.ATTRIBUTE_CHANNELS[name]) for name in opcode.REQUIRED_ATTRIBUTES]
    parts += chunks * [records.encode_chunk(0.0, 2.0, 0, count, before + b"".join(streams))]
    path.write_bytes(b"".join(parts))


def test_bomb_is_a_scene_if_it_is_small(tmp_path: Path) -> None:
    bomb(tmp_path / "scene.4dgs", 2, 3)
    assert len(open_frames(tmp_path / "scene.4dgs").read(0)) == 6


UNKNOWN = (200, 1, 0, 1, 1, 4, 4)
"""Header of a stream of an unknown attribute, coded as zstd, with 4 bytes of content."""


@pytest.mark.parametrize("damaged", [False, True])
@pytest.mark.parametrize(("chunks", "count"), [(1, 20_000_000), (100, 20_000)])
def test_repeated_points_that_take_too_much_memory_are_refused(
    tmp_path: Path, chunks: int, count: int, damaged: bool
) -> None:
    """A stream of an unknown attribute is skipped by the reader, and does not end the check if it is damaged."""
    from fourdgs import serialization

    before = serialization._STREAM_HEADER.pack(*UNKNOWN) + b"\xff\xff\xff\xff" if damaged else b""
    bomb(tmp_path / "scene.4dgs", chunks, count, before)
    assert (tmp_path / "scene.4dgs").stat().st_size < 100_000
    tracemalloc.start()
    try:
        with pytest.raises(GaussiansError, match=r"scene\.4dgs: .*--max-memory"):
            open_frames(tmp_path / "scene.4dgs")
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("seconds", [np.inf, -np.inf, np.nan, 1e300, -1.0])
def test_impossible_durations_are_refused(tmp_path: Path, seconds: float) -> None:
    from fourdgs import opcode, records, serialization

    path = tmp_path / "scene.4dgs"
    write_scene(path)
    data, parts = path.read_bytes(), [serialization.MAGIC]
    for record in serialization.iter_records(data, len(serialization.MAGIC)):
        if record.opcode == opcode.HEADER:
            header = records.Header.parse(record.content)
            header.duration_sec = seconds
            parts.append(header.encode())
        elif record.opcode in (opcode.QUANTIZATION, opcode.WINDOW_TABLE, opcode.CHUNK):
            parts.append(serialization.put_record(record.opcode, bytes(record.content)))
    path.write_bytes(b"".join(parts))
    with pytest.raises(GaussiansError, match=r"scene\.4dgs: "):
        open_frames(path)
