from pathlib import Path

import av
import numpy as np
import pytest

from splatreel.capture.sync import synchronize
from splatreel.capture.timecode import parse_timecode, read_timecode, timecode_difference
from splatreel.progress import Silent


@pytest.mark.parametrize(
    ("text", "rate", "seconds"),
    [
        ("10:15:30:12", 25, 36930.48),
        ("00:01:00;02", 30000 / 1001, 1800 / (30000 / 1001)),  # numbers 0 and 1 of this minute are dropped
        ("00:10:00;00", 30000 / 1001, 17982 / (30000 / 1001)),
        ("00:01:00;04", 60000 / 1001, 3600 / (60000 / 1001)),
        ("24:00:00:00", 25, None),
        ("10:15:30:25", 25, None),
        ("half past ten", 25, None),
        ("10:15:30:12", 0, None),
    ],
)
def test_timecodes_are_seconds(text: str, rate: float, seconds: float | None) -> None:
    found = parse_timecode(text, rate)
    assert found is None if seconds is None else found == pytest.approx(seconds)


def test_timecodes_continue_after_midnight() -> None:
    assert timecode_difference(86399.5, 0.25) == pytest.approx(0.75)
    assert timecode_difference(0.25, 86399.5) == pytest.approx(-0.75)


def still(path: Path, timecode: str | None) -> None:
    """Write four seconds of a silent video in which nothing moves."""
    with av.open(str(path), "w") as container:
        if timecode is not None:
            container.metadata["timecode"] = timecode
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 32, 32, "yuv420p"
        for _ in range(100):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8), format="rgb24")))
        container.mux(stream.encode(None))


def test_still_silent_videos_are_synchronized_by_timecode(tmp_path: Path) -> None:
    still(tmp_path / "a.mov", "10:00:00:05")
    still(tmp_path / "b.mov", "10:00:01:10")
    assert read_timecode(tmp_path / "a.mov") == pytest.approx(36000.2)
    assert synchronize(tmp_path, Silent()) == pytest.approx({"a": 1.2, "b": 0.0})


def test_a_video_without_timecode_has_none(tmp_path: Path) -> None:
    still(tmp_path / "a.mov", None)
    assert read_timecode(tmp_path / "a.mov") is None
    (tmp_path / "b.mov").write_bytes(b"no video")
    assert read_timecode(tmp_path / "b.mov") is None
