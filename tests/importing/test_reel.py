import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.base.progress import Silent
from splatreel.codec.inspection import verify_reel
from splatreel.codec.writer import ReelWriter
from splatreel.config import COARSENESS, EncodeConfig
from splatreel.formats.splat_columns import Remarks
from splatreel.importing import reel as module
from splatreel.importing.comparison import Comparison
from splatreel.importing.frames import open_frames
from splatreel.importing.reel import SequenceEncoder, header_of, write_reel
from splatreel.play.timeline import open_reel
from splatreel.scene.gaussians import Gaussians
from tests.importing.films import BALL, WALL, cameras, scene, write_film
from tests.importing.films import frame as film_frame


def imported(folder: Path, reel: Path, frames: list[Gaussians]) -> Comparison:
    film = open_frames(write_film(folder, frames))
    header, limits = header_of(film.read(0), cameras(), None, 25)
    writer = ReelWriter(reel, header, config=EncodeConfig(coarseness=COARSENESS["high"]))
    return write_reel(film, writer, Silent(), limits)


def test_sequence_of_the_same_points_becomes_a_layer_and_groups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LENGTH", 6)
    found = imported(tmp_path / "film", tmp_path / "reel", [film_frame(number) for number in range(16)])
    timeline = open_reel(tmp_path / "reel")
    manifest = timeline.manifest
    assert verify_reel(tmp_path / "reel").groups == 3
    assert not manifest.live
    assert (manifest.frames, manifest.fps, len(manifest.layers)) == (16, 25, 1)
    assert [group.points for group in manifest.groups] == 3 * [BALL]
    assert manifest.layers[0].points == WALL
    assert manifest.presentation.limits is not None
    assert found.psnr > 40
    for number in (0, 7, 15):
        shown = np.sort(timeline.at(number / 25).means, axis=0)
        np.testing.assert_allclose(shown, np.sort(film_frame(number).means, axis=0), atol=0.02)


def test_sequence_of_new_points_becomes_short_groups(tmp_path: Path) -> None:
    frames = [scene(seed)[: 440 + seed] for seed in range(3)]
    found = imported(tmp_path / "film", tmp_path / "reel", frames)
    manifest = open_reel(tmp_path / "reel").manifest
    assert [(group.points, group.frames) for group in manifest.groups] == [(440, 1), (441, 1), (442, 1)]
    assert not manifest.layers
    assert found == Comparison(found.psnr, 3)
    assert found.psnr > 40


def test_resting_points_in_other_rows_are_stored_once(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frames = [film_frame(number)[rng.permutation(WALL + BALL)[: WALL + BALL - number]] for number in range(4)]
    imported(tmp_path / "film", tmp_path / "reel", frames)
    manifest = open_reel(tmp_path / "reel").manifest
    assert sum(layer.points for layer in manifest.layers) > 0.9 * WALL


def test_invalid_frames_are_named(tmp_path: Path) -> None:
    flat = scene()
    with pytest.raises(GaussiansError, match="frame 1 has view-dependent color of degree 1"):
        imported(
            tmp_path / "a",
            tmp_path / "x",
            [replace(flat, sh=flat.sh[:, :1]), flat],
        )
    assert imported(tmp_path / "b", tmp_path / "y", [flat, replace(flat, sh=flat.sh[:, :1])]).psnr > 40


def test_empty_frames_show_nothing(tmp_path: Path) -> None:
    found = imported(
        tmp_path / "film", tmp_path / "reel", [film_frame(0), film_frame(0)[:0], film_frame(0)[:0], film_frame(3)]
    )
    assert found.psnr > 40
    timeline = open_reel(tmp_path / "reel")
    assert [(timeline.at(number / 25).opacities > 0.01).any() for number in range(4)] == [True, False, False, True]
    assert timeline.frames == 4


def test_reel_without_cameras_uses_a_ring_without_limits() -> None:
    header, limits = header_of(scene(), None, None, 30)
    assert limits is None
    assert header.camera == header.cameras[0]
    np.testing.assert_allclose(header.up, [0, -1, 0])
    header, limits = header_of(scene(), cameras(), np.array([0.0, 0, 1]), 30)
    assert limits is not None
    np.testing.assert_allclose(header.up, [0, 0, 1])
    assert header.near < 0.2


def test_absent_points_leave_no_ghosts(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frames = [film_frame(number)[rng.permutation(WALL + BALL)[: WALL + BALL - number]] for number in range(4)]
    imported(tmp_path / "film", tmp_path / "reel", frames)
    timeline = open_reel(tmp_path / "reel")
    for number, points in enumerate(frames):
        shown = timeline.at(number / 25)
        ghosts = shown.opacities[shown.opacities < 0.5]
        assert len(shown) - len(ghosts) == len(points)
        assert ghosts.max(initial=0.0) < 0.03


class CountedFrames:
    """Sequence whose frames exist only while somebody holds them. `most` is the largest number that existed at a time."""

    antialias = False

    def __init__(self, length: int) -> None:
        self.path, self.size, self.remarks = Path("film"), 1, Remarks()
        self.fps: float | None = 25.0
        self.length, self.alive, self.most = length, 0, 0

    def __len__(self) -> int:
        return self.length

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Return a frame."""
        points = film_frame(frame)
        self.alive += 1
        self.most = max(self.most, self.alive)
        weakref.finalize(points, self.release)
        return points

    def release(self) -> None:
        """Count a frame that nobody holds any more."""
        self.alive -= 1


def test_memory_is_bounded_by_a_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LENGTH", 4)
    counts = []
    for length in (12, 36):
        film = CountedFrames(length)
        header, _ = header_of(film.read(0), cameras(), None, 25)
        writer = ReelWriter(tmp_path / str(length), header, config=EncodeConfig(coarseness=COARSENESS["low"]))
        SequenceEncoder(writer).write(film, Silent())
        counts.append(film.most)
    assert counts[1] <= counts[0] + 1
    assert counts[1] < 12
