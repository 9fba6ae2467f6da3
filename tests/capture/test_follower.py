"""Growing captures: complete frames, waiting, and their end."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.capture.base import Capture
from splatreel.capture.follower import Follower, open_growing
from splatreel.capture.growth import END, Growth
from splatreel.capture.image_sequences import is_complete_image
from tests.capture import folders
from tests.capture.recorder import KINDS, Recorder, marks

BEGUN = 26
"""Frames after which FFmpeg detects the streams of a video, because it checks their reordering."""


@contextmanager
def following(folder: Path, timeout: float = 60, **request: object) -> Iterator[tuple[Follower, list[str]]]:
    told: list[str] = []
    growth = Growth(folder, timeout)
    capture = open_growing(folder, growth, told.append, held_out=[], **request)
    try:
        with Follower(capture, growth, told.append) as follower:
            yield follower, told
    finally:
        capture.close()


def shown(capture: Capture, first: int, count: int) -> list[list[tuple[int, int]]]:
    """Return the cameras and frames that the colors of images encode."""
    names = [camera.name for camera in capture.cameras]
    return [[marks(image) for image in frame] for frame in capture.read(first, count, names)]


def expected(first: int, count: int) -> list[list[tuple[int, int]]]:
    return [[(camera, first + t) for camera in range(4)] for t in range(count)]


@pytest.mark.parametrize("kind", KINDS)
def test_follower_counts_frames_as_written(kind: str, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", kind)
    recorder.write(BEGUN)
    with following(recorder.folder) as (follower, told):
        assert follower.wait(22)
        assert follower.total is None
        assert shown(follower.capture, 0, 4) == expected(0, 4)
        recorder.write(6)
        assert follower.wait(28)
        assert shown(follower.capture, 4, 24) == expected(4, 24)
        assert shown(follower.capture, 6, 2) == expected(6, 2)  # back
        recorder.write(2)
        recorder.end()
        assert not follower.wait(35)
        assert follower.total == 34
        assert shown(follower.capture, 28, 6) == expected(28, 6)
    assert told == [f"{recorder.folder / END} says that the capture is complete. The capture has 34 frames."]


@pytest.mark.parametrize("kind", ["mkv", "segments", "pictures"])
def test_stopped_camera_is_named_and_awaited(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatreel.capture.follower.STALL", 0.3)
    recorder = Recorder(tmp_path / "show", kind, segment=2)
    recorder.write(BEGUN)
    with following(recorder.folder) as (follower, told):
        recorder.write(12, but=(2,))
        until(lambda: told)
        assert told[0].startswith("Camera cam02 has stopped: it has ")
        assert "cam02" in told[0].split("nothing new in ")[1]
        assert follower.frames <= BEGUN
        recorder.write(2, but=(0, 1, 3))
        until(lambda: len(told) > 1)
        assert told[1].startswith("Camera cam02 continues from frame ")
        (recorder.folder / END).touch()  # files are left as they are
        assert not follower.wait(38)
        assert follower.total is not None
        assert BEGUN - 1 <= follower.total <= BEGUN + 2


def test_capture_ends_after_the_timeout(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "pictures")
    recorder.write(3)
    with following(recorder.folder, timeout=1.5) as (follower, told):
        recorder.write(1)
        begun = time.monotonic()
        assert not follower.wait(5)
        assert time.monotonic() - begun > 0.3
    assert told == ["Nothing new was written for 1.5 s (--follow-timeout). The capture has 4 frames."]


def test_seconds_since_gives_the_age_of_a_frame(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "pictures")
    recorder.write(2)
    with following(recorder.folder) as (follower, _):
        assert follower.seconds_since(1) is None  # before
        before = time.monotonic()
        recorder.write(1)
        assert follower.wait(3)
        time.sleep(0.2)
        since = follower.seconds_since(2)
        assert since is not None
        assert 0.2 <= since <= time.monotonic() - before + 0.1
        assert follower.seconds_since(3) is None  # yet to come


def test_future_frames_may_be_requested(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "pictures")
    recorder.write(3)
    with following(recorder.folder, frames=(1, 6)) as (follower, told):
        assert follower.frames == 2
        assert shown(follower.capture, 0, 2) == expected(1, 2)
        recorder.write(5)
        assert follower.wait(5)
        until(lambda: follower.total is not None)
        assert follower.total == 5
    assert told == ["All frames that were asked for are there. The capture has 5 frames."]


def test_fingerprint_does_not_change_with_growth(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "mkv")
    recorder.write(BEGUN)
    with following(recorder.folder) as (follower, _):
        before = follower.capture.describe()
        recorder.write(6)
        assert follower.wait(BEGUN + 3)
        assert follower.capture.describe() == before
    with following(recorder.folder) as (follower, _):
        assert follower.capture.describe() == before
    with following(recorder.folder, width=16) as (follower, _):
        assert follower.capture.describe()["fingerprint"] != before["fingerprint"]


def test_missed_frame_uses_the_nearest(tmp_path: Path) -> None:
    """A Matroska file stores the time of each frame."""
    recorder = Recorder(tmp_path / "show", "mkv")
    recorder.write(4)
    recorder.lose(1, 2)
    recorder.write(2, but=(1,))
    recorder.write(BEGUN)
    with following(recorder.folder) as (follower, _):
        assert follower.wait(9)
        seen = shown(follower.capture, 2, 6)
    assert [frame[0] for frame in seen] == [(0, t) for t in range(2, 8)]
    assert [frame[1][1] for frame in seen] == [2, 3, 3, 6, 6, 7]


def test_partial_image_does_not_count(tmp_path: Path) -> None:
    for suffix in ("png", "jpg", "tif", "webp", "bmp"):
        file = tmp_path / f"whole.{suffix}"
        Image.effect_noise((40, 30), 80).convert("RGB").save(file)
        assert is_complete_image(file), suffix
        half = tmp_path / f"half.{suffix}"
        half.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
        assert not is_complete_image(half), suffix
    assert not is_complete_image(tmp_path / "none.png")


def test_open_growing_waits_for_the_start(tmp_path: Path) -> None:
    folder, told = tmp_path / "show", []
    recorder = Recorder(folder, "pictures")

    def tell(text: str) -> None:
        told.append(text)
        recorder.write(2)

    capture = open_growing(folder, Growth(folder, 20), tell)
    assert capture.frames == 2
    assert len(told) == 1
    assert told[0].startswith("Waiting for the capture to begin, 20 s at most. So far: ")


def test_capture_that_never_starts_is_an_error(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "mkv")
    with pytest.raises(CaptureError, match="0 videos"):
        open_growing(recorder.folder, Growth(recorder.folder, 0.3), lambda _: None)


def test_following_needs_camera_poses(tmp_path: Path) -> None:
    (tmp_path / "cam00.mkv").touch()
    with pytest.raises(CaptureError, match=r"has no camera poses.*capture calibrate"):
        open_growing(tmp_path, Growth(tmp_path, 60), lambda _: None)


def test_layouts_with_frame_lists_are_not_followed(tmp_path: Path) -> None:
    for made in (folders.panoptic(tmp_path / "panoptic"), folders.technicolor(tmp_path / "technicolor")):
        with pytest.raises(CaptureError, match="list their frames in advance"):
            open_growing(made, Growth(made, 60), lambda _: None)


def test_unfragmented_mp4_is_not_followed(tmp_path: Path) -> None:
    folder = folders.neu3dv(tmp_path / "show")
    whole = (folder / "cam01.mp4").read_bytes()
    assert whole.index(b"mdat") < whole.index(b"moov")
    with pytest.raises(CaptureError, match=r"cam01\.mp4: is an MP4 file that cannot be read before|cam00\.mp4"):
        open_growing(folder, Growth(folder, 0.2), lambda _: None)


def test_file_without_video_is_not_followed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "mkv")
    recorder.write(BEGUN)
    (recorder.folder / "cam02.mkv").write_bytes(b"nothing" * 1000)
    with pytest.raises(CaptureError, match=r"cam02\.mkv: cannot be decoded.*Matroska"):
        open_growing(recorder.folder, Growth(recorder.folder, 0.2), lambda _: None)


def test_image_numbers_must_start_together(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "pictures")
    recorder.write(3)
    (recorder.folder / "images" / "cam03" / "000000.png").unlink()
    with pytest.raises(CaptureError, match=r"cam03 begin at 000001\.png, others' at number 0"):
        open_growing(recorder.folder, Growth(recorder.folder, 0.2), lambda _: None)


def test_stop_ends_waits(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "mkv")
    recorder.write(BEGUN)
    with following(recorder.folder, timeout=1000) as (follower, told):
        follower.stop()
        assert not follower.wait(BEGUN + 9)
    assert told == []


def until(true: Callable[[], object], seconds: float = 120) -> None:
    """Wait for a condition."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)
