"""A followed capture can be opened like any other after its end."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from splatreel.capture.capture_sound import choose
from splatreel.capture.follower import Follower, open_growing
from splatreel.capture.growth import Growth
from splatreel.capture.opening import open_capture
from tests.capture.recorder import KINDS, RATE, Recorder, marks

FRAMES = 14


def tone(frame: int) -> np.ndarray:
    return (0.5 * (-1.0) ** (frame // 5) * np.sin(np.arange(RATE // 10) / 5)).astype(np.float32)


def recorded(folder: Path, kind: str) -> Recorder:
    """Return a capture whose last camera stopped two frames before the others."""
    recorder = Recorder(folder, kind, sound=None if kind == "pictures" else tone)
    recorder.write(FRAMES)
    recorder.write(2, but=(3,))
    return recorder


@pytest.mark.parametrize("kind", KINDS)
def test_recorded_capture_opens_as_followed(kind: str, tmp_path: Path) -> None:
    recorder = recorded(tmp_path / "show", kind)
    recorder.end()
    growth = Growth(tmp_path / "show", 5.0)
    with (
        closing(open_growing(tmp_path / "show", growth, print)) as followed,
        closing(open_capture(tmp_path / "show")) as again,
    ):
        names = [camera.name for camera in again.cameras]
        assert (names, again.fps, again.held_out) == (
            [camera.name for camera in followed.cameras],
            followed.fps,
            followed.held_out,
        )
        assert again.frames == FRAMES
        found = again.read(0, FRAMES, names)
        assert [[marks(image) for image in images] for images in found] == [
            [(camera, frame) for camera in range(len(names))] for frame in range(FRAMES)
        ]
        with Follower(followed, growth, print) as follower:
            assert follower.wait(8)
            assert np.array_equal(followed.read(3, 5, names), found[3:8])
        assert again.read(9, 1, names[:1]).shape[0] == 1
        if kind != "pictures":
            choice = choose("auto", again.tracks(), 1.0, 0.0, again.path)
            assert choice is not None
            assert choice.camera == names[0]
            assert sum(len(block) for block in choice.samples(1.0, 0.2)) == RATE


def test_recorded_missed_frame_uses_the_nearest(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "ts")
    recorder.write(5)
    recorder.lose(1, 2)
    recorder.write(2, but=(1,))
    recorder.write(5)
    recorder.end()
    with closing(open_capture(tmp_path / "show")) as capture:
        assert capture.frames == 12
        found = capture.read(4, 5, [capture.cameras[1].name])[:, 0]
        assert [marks(image)[1] for image in found] == [4, 4, 7, 7, 8]


def test_segmented_videos_need_no_end_mark(tmp_path: Path) -> None:
    recorder = recorded(tmp_path / "show", "segments")
    recorder.end()
    (tmp_path / "show" / "splatreel.end").unlink()
    with closing(open_capture(tmp_path / "show")) as capture:
        assert capture.frames == FRAMES
        assert set(capture.frame_tables()) >= {"cam00/000000.mp4", "cam03/000003.mp4"}
