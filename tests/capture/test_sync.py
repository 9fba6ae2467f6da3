import json
import os
from pathlib import Path

import numpy as np
import pytest

from splatreel.capture.sync import RATE, synchronize
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
    assert json.loads((folder / "splatreel.json").read_text()) == {"fps": 10, "starts": starts}


def test_sync_names_a_video_without_sound(folder: Path) -> None:
    film(folder / "d.mp4", None)
    with pytest.raises(CaptureError, match=r"d\.mp4: has no sound"):
        synchronize(folder, Silent())
    assert not (folder / "splatreel.json").exists()


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
