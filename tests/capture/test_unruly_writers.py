"""Writers that delete, rewrite or skip files: earlier frames stay valid, and nothing hangs."""

import os
from contextlib import closing
from pathlib import Path

import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture.recorder import Recorder
from tests.capture.test_follower import BEGUN, expected, following, shown


def test_deleted_image_is_named(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "pictures")
    recorder.write(6)
    with following(recorder.folder) as (follower, _):
        assert follower.wait(6)
        name = recorder.views[2].name
        gone = recorder.folder / "images" / name / "000003.png"
        gone.unlink()
        with pytest.raises(CaptureError, match=r"000003\.png"):
            follower.capture.read(3, 1, [name])
        assert shown(follower.capture, 4, 2) == expected(4, 2)


def test_rewritten_image_is_read_again(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "pictures")
    recorder.write(6)
    with following(recorder.folder) as (follower, _):
        assert follower.wait(6)
        place = recorder.folder / "images" / recorder.views[1].name
        (place / "000005.png").write_bytes((place / "000002.png").read_bytes())
        assert shown(follower.capture, 5, 1)[0][1] == (1, 2)
        (place / "000005.png").write_bytes(b"no image")
        with pytest.raises(CaptureError, match=r"000005\.png"):
            shown(follower.capture, 5, 1)


def test_skipped_numbers_are_reported_at_the_end(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "pictures")
    recorder.write(6)
    for camera in recorder.written:
        recorder.written[camera] += 100
    recorder.write(3)
    recorder.end()
    with following(recorder.folder) as (follower, told):
        assert not follower.wait(7)
        assert follower.total == 6, "what comes after the gap cannot be placed"
    assert "The capture has 6 frames." in told[-1]


def test_deleted_segment_is_named(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "segments")
    recorder.write(BEGUN)
    with following(recorder.folder) as (follower, _):
        assert follower.wait(12)
        name = recorder.views[0].name
        (recorder.folder / name / "000001.mp4").unlink()
        with pytest.raises(CaptureError, match=r"000001\.mp4"):
            follower.capture.read(4, 4, [name])


def test_truncated_growing_video_is_an_error(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "mkv")
    recorder.write(BEGUN)
    with following(recorder.folder, timeout=10) as (follower, _):
        assert follower.wait(20)
        file = recorder.folder / f"{recorder.views[0].name}.mkv"
        with open(file, "r+b") as opened:
            opened.truncate(file.stat().st_size // 8)
        with pytest.raises(CaptureError, match=rf"{recorder.views[0].name}\.mkv"):
            follower.capture.read(15, 4, [recorder.views[0].name])


@pytest.mark.parametrize(
    ("kind", "before", "left"), [("mkv", 16, 16), ("ts", 16, 16), ("mp4", 16, 16), ("segments", 14, 12)]
)
def test_clock_that_jumps_ends_the_camera(tmp_path: Path, kind: str, before: int, left: int) -> None:
    recorder = Recorder(tmp_path / "show", kind)
    recorder.write(before)
    for camera in (1, 2):
        recorder.jump(camera, 36_000)
    recorder.write(20)
    recorder.end()
    name = recorder.views[1].name
    with following(recorder.folder) as (follower, told):
        assert not follower.wait(20)
        assert follower.total == left
        assert shown(follower.capture, 8, left - 8) == expected(8, left - 8)
    (line,) = [line for line in told if line.startswith(f"Camera {name} ends after {left} frames")]
    assert "time jumps" in line
    with pytest.raises(CaptureError, match=rf"{name}.*its time jumps 1\.\d s after .*--frames 0:{left}"):
        open_capture(recorder.folder)
    with closing(open_capture(recorder.folder, frames=(0, left), held_out=[])) as capture:
        assert shown(capture, 8, left - 8) == expected(8, left - 8)


def test_recorder_that_starts_anew_in_its_file_ends_the_camera(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "ts")
    recorder.write(16)
    recorder.end()
    file = recorder.folder / f"{recorder.views[2].name}.ts"
    file.write_bytes(2 * file.read_bytes())
    with following(recorder.folder) as (follower, told):
        assert not follower.wait(20)
        assert follower.total == 16
        assert shown(follower.capture, 0, 14) == expected(0, 14)  # what follows is cut off
    assert any(f"{file}: its time jumps from 1.5 s to" in line for line in told)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_pipe_among_images_does_not_block(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "pictures")
    recorder.write(4)
    with following(recorder.folder) as (follower, _):
        assert follower.wait(4)
        os.mkfifo(recorder.folder / "images" / recorder.views[0].name / "000004.png")
        recorder.end()
        assert not follower.wait(5)
        assert follower.total == 4


def test_missing_file_of_a_numbered_video_is_named(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "segments")
    recorder.write(16)
    recorder.end()
    name = recorder.views[2].name
    (recorder.folder / name / "000002.mp4").unlink()
    with pytest.raises(CaptureError, match=rf"{name}/000002\.mp4: is missing, though later ones exist"):
        open_capture(recorder.folder)


def test_lost_image_stops_no_other_camera(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "pictures")
    recorder.write(6)
    recorder.written[1] += 2
    recorder.write(2, but=(1,))
    recorder.write(8)
    name = recorder.views[1].name
    with following(recorder.folder) as (follower, _):
        assert follower.wait(16)
        assert follower.capture.missing(5, 4, [name])[:, 0].tolist() == [False, True, True, False]
        assert [step[1][1] for step in shown(follower.capture, 4, 6)] == [4, 5, 5, 5, 8, 9]
        recorder.end()
    with closing(open_capture(recorder.folder)) as capture:
        assert capture.missing(5, 4, [name])[:, 0].tolist() == [False, True, True, False]
