import json
import os
from pathlib import Path

import av
import numpy as np
import pytest

from splatreel.capture.sidecar import read_sidecar
from splatreel.capture.sync import RATE, synchronize
from splatreel.capture.visible_sync import compare_activity
from splatreel.errors import CaptureError
from splatreel.progress import Silent
from tests.capture.films import film

HEARD = 44100
BEGAN = {"a": 0.4, "b": 1.25, "c": 0.0}
"""Seconds of the scene at which each video starts."""


def scene(seconds: float) -> np.ndarray:
    """Return claps and a hum, [samples]."""
    rng = np.random.default_rng(0)
    sound = 0.02 * np.sin(np.arange(round(seconds * HEARD)) * 0.02)
    for at in rng.uniform(0, seconds - 0.1, 12):
        clap = rng.normal(size=2000) * np.exp(-np.arange(2000) / 300)
        sound[round(at * HEARD) :][:2000] += 0.3 * clap
    return sound


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    whole, rng = scene(6), np.random.default_rng(1)
    for name, start in BEGAN.items():
        heard = whole[round(start * HEARD) :][: 4 * HEARD]
        film(tmp_path / f"{name}.mp4", heard + 0.01 * rng.normal(size=len(heard)))
    return tmp_path


def test_sync_starts_when_all_videos_run(folder: Path) -> None:
    (folder / "splatreel.json").write_text('{"fps": 10}')
    starts = synchronize(folder, Silent())
    assert starts == pytest.approx({name: 1.25 - began for name, began in BEGAN.items()}, abs=2 / RATE)
    written = json.loads((folder / "splatreel.json").read_text())
    sync = written.pop("sync")
    assert written == {"fps": 10, "starts": starts}
    assert sorted(sync) == ["b", "c"], "the others are aligned with the first"
    for found in read_sidecar(folder).sync.values():
        assert found.by == "sound"
        assert (found.clear or 0) > (found.needed or 0) > 1


def test_sync_names_a_silent_video_without_motion(folder: Path) -> None:
    film(folder / "d.mp4", None)
    with pytest.raises(CaptureError, match="d has no sound, and no motion or flash"):
        synchronize(folder, Silent())
    assert not (folder / "splatreel.json").exists()


def moving(path: Path, began: float, side: int, seconds: float = 8) -> None:
    """Write a silent video, 30 frames per second, of a disk that moves in fits; `side` mirrors and shades the view."""
    rng = np.random.default_rng(7)
    speeds = np.repeat(
        rng.uniform(0, 40, 40) * (rng.random(40) < 0.5), 30
    )  # pixels per second, each for a quarter second
    places = np.cumsum(speeds) / 120
    y, x = np.mgrid[:72, :96]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 96, 72, "yuv420p"
        for number in range(round(seconds * 30)):
            place = 10 + places[min(round((began + number / 30) * 120), len(places) - 1)] % 70
            disk = (x - (place if side else 95 - place)) ** 2 + (y - 30 - 10 * side) ** 2 < 150
            picture = np.where(disk, 210, 60 + 30 * side).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(np.repeat(picture[..., None], 3, 2), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def test_silent_videos_are_synchronized_by_motion(tmp_path: Path) -> None:
    moving(tmp_path / "a.mp4", 0.5, 0)
    moving(tmp_path / "b.mp4", 1.7, 1)
    starts = synchronize(tmp_path, Silent())
    assert starts["b"] == 0
    assert starts["a"] == pytest.approx(1.2, abs=0.02)
    found = read_sidecar(tmp_path).sync["b"]
    assert (found.other, found.by) == ("a", "motion and light")
    assert (found.clear or 0) > (found.needed or 0) > 1


def test_a_flash_synchronizes_a_silent_video() -> None:
    rng = np.random.default_rng(3)
    one, other = (rng.normal(0, 0.2, (2, 1200)) for _ in range(2))
    one[1, 600:604] += 40
    other[1, 240:244] += 25
    agreement = compare_activity(one, other)
    assert agreement.certain
    assert agreement.later == pytest.approx(3.0, abs=0.01)


def test_unrelated_activity_is_not_certain() -> None:
    rng = np.random.default_rng(4)
    assert not compare_activity(*rng.normal(0, 1, (2, 2, 1200))).certain
    assert not compare_activity(np.zeros((2, 1200)), np.zeros((2, 1200))).certain
    assert not compare_activity(np.zeros((2, 9)), np.zeros((2, 1200))).certain


def test_sync_names_a_video_with_other_sound(folder: Path) -> None:
    film(folder / "d.mp4", 0.1 * np.random.default_rng(2).normal(size=4 * HEARD))
    with pytest.raises(CaptureError, match="the sound of d matches none"):
        synchronize(folder, Silent())


def test_sync_needs_two_videos(tmp_path: Path) -> None:
    film(tmp_path / "a.mp4", None)
    with pytest.raises(CaptureError, match="1 videos"):
        synchronize(tmp_path, Silent())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes")
def test_pipe_among_videos_does_not_block(tmp_path: Path) -> None:
    for name in ("a.mp4", "b.mp4"):
        os.mkfifo(tmp_path / name)
    with pytest.raises(CaptureError, match=r"a\.mp4: is no file"):
        synchronize(tmp_path, Silent())
