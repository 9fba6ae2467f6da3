""""""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.capture_sound import GAP
from splatreel.capture.color import BT2020, HLG
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.follower import open_growing
from splatreel.capture.growing_video import GrowingVideo, choose_growing_track
from splatreel.capture.growth import Growth
from splatreel.capture.video import VideoFile
from splatreel.capture.videos import GrowingVideos
from tests.capture.colors import COLORS, SIDE, write_colors, write_display_matrix
from tests.capture.recorder import CONTAINERS, RATE, Recorder

FPS = 10
FRAMES = 30


def clicks(frame: int) -> np.ndarray:
    """Return a tone with a burst at the start of every fifth frame."""
    time = (frame * RATE // FPS + np.arange(RATE // FPS)) / RATE
    tone = 0.05 * np.sin(2 * np.pi * 200 * time)
    if frame % 5 == 0:
        tone[:480] += 0.8 * np.sin(2 * np.pi * 1000 * time[:480])
    return tone.astype(np.float32)


def heard(sound: np.ndarray) -> list[float]:
    """Return the times in seconds at which bursts start."""
    loud = np.flatnonzero(np.abs(sound) > 0.4)
    return [float(at) / RATE for at in loud[np.diff(loud, prepend=-RATE) > RATE // 10]]


@pytest.mark.parametrize("kind", ["mkv", "ts", "mp4", "segments"])
def test_segmented_sound_is_continuous_and_in_sync(kind: str, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", kind, fps=FPS, sound=clicks, segment=7)
    recorder.write(FRAMES)
    recorder.end()
    with closing(open_growing(recorder.folder, Growth(recorder.folder, 60), lambda _: None, held_out=[])) as capture:
        assert isinstance(capture, FileCapture)
        source = capture.source
        assert isinstance(source, GrowingVideos)
        source.settle()
        sound = np.concatenate(list(source.sound("cam00", 1, 0, 0.0)))[:, 0]
        later = np.concatenate(list(source.sound("cam00", 1, 0, 1.25)))[:, 0]
    assert len(sound) == pytest.approx(FRAMES / FPS * RATE, abs=0.05 * RATE)
    off = GAP if kind == "segments" else 0.003  # there each file's sound is a little longer than its images
    np.testing.assert_allclose(heard(sound), np.arange(0, FRAMES, 5) / FPS, atol=off)
    np.testing.assert_allclose(heard(later), np.arange(15, FRAMES, 5) / FPS - 1.25, atol=off)
    between = sound[int(0.02 * RATE) : int(2.9 * RATE)].reshape(-1, 480)
    assert np.abs(between).max(1).min() > 0.02, "no silence, also where files meet"


def test_growing_track_is_chosen_by_sound_so_far(tmp_path: Path) -> None:
    loud = Recorder(tmp_path / "loud", "ts", fps=FPS, sound=clicks)
    silent = Recorder(tmp_path / "silent", "ts", fps=FPS, sound=lambda frame: 0 * clicks(frame))
    for recorder in (loud, silent):
        recorder.write(FRAMES)
    noisy, quiet, mute = (tmp_path / name for name in ("loud/cam00.ts", "silent/cam00.ts", "loud/cam01.ts"))
    files = {"a": quiet, "b": noisy, "c": mute}
    assert choose_growing_track("auto", files, 2.0, tmp_path) == ("b", 1)
    assert choose_growing_track("auto", {"a": quiet, "c": mute}, 2.0, tmp_path) == ("a", 1)  # it may still be heard
    assert choose_growing_track("auto", {"c": mute}, 2.0, tmp_path) is None
    assert choose_growing_track("none", files, 2.0, tmp_path) is None
    assert choose_growing_track("a", files, 2.0, tmp_path) == ("a", 1)
    with pytest.raises(CaptureError, match="the cameras with sound are a, b"):
        choose_growing_track("c", files, 2.0, tmp_path)


@pytest.mark.parametrize("suffix", CONTAINERS)
def test_color_and_orientation_are_those_of_the_complete_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    write_colors(
        path, COLORS / 255, (BT2020, BT2020, HLG), bits=10, frames=3, lines=2 * SIDE, options=CONTAINERS[suffix][1]
    )
    if suffix == "mp4":
        write_display_matrix(path, (0, 1, 1, 0))
    growing, complete = GrowingVideo(path, Growth.over(tmp_path)), VideoFile(path)
    try:
        shape = (1, complete.height, complete.width, 3)
        assert (growing.height, growing.width) == shape[1:3]
        assert growing.color == complete.color
        found, expected = np.empty(shape, np.uint8), np.empty(shape, np.uint8)
        growing.read_into(found, np.array([1]))
        complete.read_into(expected, np.array([1]))
        np.testing.assert_array_equal(found, expected)
    finally:
        growing.close()


def test_ambiguous_color_is_refused_on_opening(tmp_path: Path) -> None:
    path = write_colors(tmp_path / "a.mkv", COLORS / 255, (BT2020, 2, 2), bits=10)
    with pytest.raises(CaptureError, match=r"a\.mkv: declares BT\.2020 colors but no transfer function"):
        GrowingVideo(path, Growth.over(tmp_path))
    growing = GrowingVideo(path, Growth.over(tmp_path), "hlg")
    assert growing.color.transfer == HLG
    growing.close()
