""""""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.calibration.clocks import (
    Lag,
    Timecode,
    TimecodeRate,
    fit_lag,
    nominal_rate,
    parse_timecode,
    read_timecode,
    significant_drift,
    timecode_difference,
)
from splatreel.calibration.sync import synchronize

TIMES = np.arange(20) * 4.0


def test_a_line_is_found_among_wrong_lags() -> None:
    rng = np.random.default_rng(0)
    lags = 3.2 + 0.001 * TIMES + rng.normal(0, 3e-4, 20)
    lags[rng.permutation(20)[:12]] = rng.uniform(-60, 60, 12)
    found = fit_lag(TIMES, lags, 0.003, share=0.25)
    assert found is not None
    assert found.start == pytest.approx(3.2, abs=1e-3)
    assert found.drift == pytest.approx(0.001, abs=3e-5)


def test_unrelated_lags_have_no_line() -> None:
    assert fit_lag(TIMES, np.random.default_rng(1).uniform(-60, 60, 20), 0.003, share=0.25) is None
    assert fit_lag(TIMES[:3], np.zeros(3), 0.003) is None


def test_noise_and_small_changes_are_no_drift() -> None:
    rng = np.random.default_rng(2)
    assert significant_drift(TIMES, 3.2 + rng.normal(0, 3e-4, 20), 0.003, 0.0, 0.016) is None
    assert significant_drift(TIMES, 3.2 + 1e-4 * TIMES, 0.003, 0.0, 0.016) is None
    assert significant_drift(TIMES, 3.2 + 1e-3 * TIMES, 0.003, 0.0, 0.016) is not None


def test_reversed_lags_are_those_of_the_other_clock() -> None:
    lag = Lag(2.0, 0.001)
    one = 50.0
    other = one - lag.at(one)
    assert other - one == pytest.approx(lag.reversed().at(other))


NTSC = TimecodeRate(30, 30000 / 1001)


def timecode(text: str, rate: TimecodeRate) -> Timecode:
    found = parse_timecode(text, rate)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("text", "rate", "number"),
    [
        ("10:15:30:12", TimecodeRate(25, 25), 36930 * 25 + 12),
        ("00:01:00;02", NTSC, 1800),  # numbers 0 and 1 of this minute are dropped
        ("00:10:00;00", NTSC, 17982),
        ("00:01:00;04", TimecodeRate(60, 60000 / 1001), 3600),
        ("23:59:59:119", TimecodeRate(120, 120), 24 * 3600 * 120 - 1),
        ("24:00:00:00", TimecodeRate(25, 25), None),
        ("10:15:30:25", TimecodeRate(25, 25), None),
        ("half past ten", TimecodeRate(25, 25), None),
        ("10:15:30:12", None, None),
    ],
)
def test_timecodes_are_numbers_of_frames(text: str, rate: TimecodeRate | None, number: int | None) -> None:
    found = parse_timecode(text, rate)
    assert (found and found.number) == number


@pytest.mark.parametrize(
    ("one", "other", "seconds"),
    [
        (("23:59:59:12", TimecodeRate(25, 25)), ("00:00:00:07", TimecodeRate(25, 25)), 20 / 25),
        (("00:00:00:07", TimecodeRate(25, 25)), ("23:59:59:12", TimecodeRate(25, 25)), -20 / 25),
        (("23:59:59;28", NTSC), ("00:00:00;01", NTSC), 3 * 1001 / 30000),
        (("10:00:00:00", NTSC), ("10:01:40:00", NTSC), 100.1),  # 3,000 frames of 29.97
        (("10:15:30;00", NTSC), ("10:15:30:00", NTSC), 0),  # with and without drops: both show the time of day
        (("10:15:30:00", TimecodeRate(30, 30)), ("10:15:31:10", NTSC), 1 + 1 / 3),
        (("10:15:30:00", TimecodeRate(25, 25)), ("10:15:31:48", TimecodeRate(60, 60)), 1.8),
    ],
)
def test_differences_are_those_of_the_clocks(
    one: tuple[str, TimecodeRate], other: tuple[str, TimecodeRate], seconds: float
) -> None:
    assert timecode_difference(timecode(*one), timecode(*other)) == pytest.approx(seconds, abs=0.05)


@pytest.mark.parametrize(
    ("measured", "counted", "true"),
    [
        (29.99, 30, 29.99),
        (29.97003, 30, 30000 / 1001),
        (23.976, 24, 24000 / 1001),
        (25.0, 25, 25),
        (58.8, 60, 58.8),  # median gap of 17 milliseconds
        (15.0, 15, 15),
        (0.0, None, None),
    ],
)
def test_rates_that_cameras_count(measured: float, counted: int | None, true: float | None) -> None:
    found = nominal_rate(measured)
    assert (found and found.counted) == counted
    assert true is None or (found is not None and found.true == pytest.approx(true))


def still(
    path: Path,
    code: str | None,
    rate: Fraction = Fraction(25),
    lost: tuple[int, ...] = (),
    seconds: float = 4,
    times: list[int] | None = None,
) -> Path:
    """Write a silent video in which nothing moves, without the frames `lost`, or with frames at `times` in milliseconds."""
    with av.open(str(path), "w") as container:
        if code is not None:
            container.metadata["timecode"] = code
        stream = container.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = 32, 32, "yuv420p"
        if times is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        base = 1 / rate if times is None else Fraction(1, 1000)
        for number in range(round(seconds * rate)) if times is None else times:
            if number not in lost:
                frame = av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8), format="rgb24")
                frame.pts, frame.time_base = number, base
                container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def test_still_silent_videos_are_synchronized_by_timecode(tmp_path: Path) -> None:
    still(tmp_path / "a.mov", "10:00:00:05")
    still(tmp_path / "b.mov", "10:00:01:10")
    assert read_timecode(tmp_path / "a.mov") == timecode("10:00:00:05", TimecodeRate(25, 25))
    assert synchronize(tmp_path, Silent()).starts == pytest.approx({"a": 1.2, "b": 0.0})


@pytest.mark.parametrize("suffix", [".mov", ".mp4"])
def test_a_dropped_frame_shifts_nothing(tmp_path: Path, suffix: str) -> None:
    still(tmp_path / f"a{suffix}", "10:15:30:00", Fraction(30))
    still(tmp_path / f"b{suffix}", "10:15:30:00", Fraction(30), lost=(47, 48))
    still(tmp_path / f"c{suffix}", "10:15:31:00", Fraction(30), lost=(99,))
    assert synchronize(tmp_path, Silent()).starts == pytest.approx({"a": 1, "b": 1, "c": 0}, abs=1e-3)


def test_timecodes_with_and_without_drops_are_the_time_of_day(tmp_path: Path) -> None:
    rate = Fraction(30000, 1001)
    still(tmp_path / "a.mov", "10:15:30;00", rate)
    still(tmp_path / "b.mov", "10:15:30:00", rate)
    starts = synchronize(tmp_path, Silent()).starts
    assert max(starts.values()) < 0.05


def test_variable_frame_rates_count_the_usual_gap(tmp_path: Path) -> None:
    """In dim light, a phone films 24 frames in a second of 30."""
    times = [33 * number + 9 * max(number - 60, 0) for number in range(90)]
    still(tmp_path / "a.mov", "10:15:30:15", times=times, rate=Fraction(30))
    found = read_timecode(tmp_path / "a.mov")
    assert found is not None
    assert found.time_of_day == pytest.approx(36930.5)


def test_timecodes_further_apart_than_the_videos_are_refused(tmp_path: Path) -> None:
    still(tmp_path / "a.mov", "10:15:30:00")
    still(tmp_path / "b.mov", "10:15:33:00")
    still(tmp_path / "c.mov", "17:20:00:00")
    with pytest.raises(
        CaptureError, match=r"c\.mov start.* timecode 17:20:00:00 is 25470 s from 10:15:30:00 of a, longer.*starts"
    ):
        synchronize(tmp_path, Silent())
    assert not (tmp_path / "splatreel.json").exists()


def test_the_rate_of_the_timecode_track_counts(tmp_path: Path) -> None:
    """FFmpeg shows the number of the first frame, 1,846,520, by this rate."""
    file = still(tmp_path / "a.mov", "10:15:30:20", Fraction(50))
    data = file.read_bytes()
    at = data.index(b"\0\0\0\x24tmcd\0\0\0\0\0\0") + 8 + 16
    scale = int.from_bytes(data[at : at + 4], "big")
    track = (scale // 25).to_bytes(4, "big") + bytes([25])
    file.write_bytes(data[: at + 4] + track + data[at + 9 :])
    found = read_timecode(file)
    assert found is not None
    assert found.rate == TimecodeRate(25, 25)
    assert (found.text, found.time_of_day) == ("20:31:00:20", pytest.approx(73860.8))


def test_a_video_without_timecode_has_none(tmp_path: Path) -> None:
    still(tmp_path / "a.mov", None)
    assert read_timecode(tmp_path / "a.mov") is None
    (tmp_path / "b.mov").write_bytes(b"no video")
    assert read_timecode(tmp_path / "b.mov") is None


def test_two_countings_of_timecode_are_named(tmp_path: Path) -> None:
    rate = Fraction(30000, 1001)
    still(tmp_path / "a.mov", "10:15:30:00", rate)
    still(tmp_path / "b.mov", "10:15:30;00", rate)
    still(tmp_path / "c.mov", "10:15:30:00", rate)
    notes = [note for note in synchronize(tmp_path, Silent()).notes if "drop-frame" in note]
    assert len(notes) == 1
    assert "b has a drop-frame timecode (10:15:30;00) and a one that counts every frame (10:15:30:00)" in notes[0]
