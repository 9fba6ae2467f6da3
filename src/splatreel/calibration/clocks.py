"""Clocks of cameras: timecodes, and lines through the lags between clocks that drift."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from av.error import FFmpegError

from splatreel.base.errors import CaptureError
from splatreel.capture.files import LOCAL, open_media
from splatreel.capture.video import SUFFIXES, VideoFile, top_level_boxes
from splatreel.capture.videos import frame_rate

FASTEST = 0.005
"""Maximum drift of a clock, in seconds per second. Larger ones are other frame rates."""
LEAST = 4
"""Minimum number of lags on a line."""
SHARE = 0.5
"""Minimum share of the lags on a line, where all of them are near the right one."""
STRAIGHT = 0.5
"""Maximum ratio of the residual of a line to that of a constant for a line to be a drift."""


@dataclass(frozen=True)
class Lag:
    """Difference between the clocks of two videos, in seconds.

    Attributes:
        start: Time of the first video at which the second one starts, as its clock would show it at time 0.
        drift: Change of the difference in a second of the first video.
        residual: Root mean square distance of the measured lags from this line.
        count: Number of measured lags on this line.
    """

    start: float
    drift: float = 0.0
    residual: float = 0.0
    count: int = 0

    def at(self, time: float) -> float:
        """Return the difference at a time of the first video."""
        return self.start + self.drift * time

    def reversed(self) -> Lag:
        """Return the difference of the first video from the second."""
        rate = 1 - self.drift
        return Lag(-self.start / rate, -self.drift / rate, self.residual, self.count)


def fit_lag(
    times: np.ndarray, lags: np.ndarray, tolerance: float, spread: float = 0.0, share: float = SHARE
) -> Lag | None:
    """Return the line that most lags are on, or None if few are on any.

    Args:
        times: Times of the first video, [N] seconds.
        lags: Its time minus that of the second video, [N] seconds.
        tolerance: Maximum distance of a lag from the line, in seconds.
        spread: Maximum distance of a time from that at which its lag was measured, in seconds.
        share: Minimum share of the lags that must be on it.
    """
    best = np.zeros(len(times), bool)
    for i in range(len(times)):
        for j in range(i + 1, len(times)):
            drift = (lags[j] - lags[i]) / (times[j] - times[i])
            if abs(drift) <= FASTEST:
                near = np.abs(lags - lags[i] - drift * (times - times[i])) <= tolerance + spread * abs(drift)
                if near.sum() > best.sum():
                    best = near
    if best.sum() < max(LEAST, share * len(times)):
        return None
    drift, start = np.polyfit(times[best], lags[best], 1)
    residual = float(np.sqrt(np.mean((lags[best] - start - drift * times[best]) ** 2)))
    return Lag(float(start), float(drift), residual, int(best.sum()))


def significant_drift(times: np.ndarray, lags: np.ndarray, tolerance: float, spread: float, least: float) -> Lag | None:
    """Return the line through lags if it is a drift, or None for clocks of one speed.

    Arguments are those of `fit_lag`. All lags should be near the right one, and their change must be `least` seconds.
    """
    line = fit_lag(times, lags, tolerance, spread)
    if line is None or abs(line.drift) * float(np.ptp(times)) < least:
        return None
    on = np.abs(lags - line.start - line.drift * times) <= tolerance + spread * abs(line.drift)
    return line if line.residual <= STRAIGHT * float(np.std(lags[on])) else None


DAY = 86400
"""Seconds after which a timecode starts again."""
NOMINAL = (24, 25, 30, 48, 50, 60, 72, 90, 96, 100, 120)
"""Frames that common timecodes and cameras count in a second."""
NTSC = 1000 / 1001
"""Ratio of the true rate to the counted one, as 29.97 to 30."""
SAME_RATE = 2e-4
"""Maximum relative difference of equal frame rates; a fifth of the difference between 29.97 and 30."""
NEAR = 0.03
"""Maximum relative difference of a rate in whole milliseconds from the one that is counted."""
STEADY = 0.02
"""Maximum relative difference between the mean rate and that of the median gap for a constant frame rate."""
HEADER_BYTES = 64 << 20
"""Maximum size of the tables of an MP4 file that are searched for the timecode's own rate."""


@dataclass(frozen=True)
class TimecodeRate:
    """Rate of a timecode.

    Attributes:
        counted: Number of frames counted in a second of the timecode.
        true: Frames per second.
    """

    counted: int
    true: float


@dataclass(frozen=True)
class Timecode:
    """Timecode of a video's first frame.

    Attributes:
        number: Number of the frame, counted from midnight.
        drops: True if numbers are dropped, so that the timecode follows the time of day.
    """

    text: str
    number: int
    rate: TimecodeRate
    drops: bool

    @property
    def frames_a_day(self) -> int:
        """Number of frames counted from midnight to midnight."""
        dropped = _dropped(self.rate.counted) * 24 * 54 if self.drops else 0
        return DAY * self.rate.counted - dropped

    @property
    def time_of_day(self) -> float:
        """Seconds since midnight that the timecode shows."""
        return self.number * DAY / self.frames_a_day

    def counts_as(self, other: Timecode) -> bool:
        """Return whether both timecodes count the same frames, so that their numbers can be subtracted."""
        same = self.rate.counted == other.rate.counted and self.drops == other.drops
        return same and abs(self.rate.true / other.rate.true - 1) <= SAME_RATE


def read_timecode(file: Path) -> Timecode | None:
    """Return the timecode of a video's first frame, or None if the video has none that is valid."""
    try:
        with open_media(LOCAL, file) as container:
            tags = [container.metadata, *(stream.metadata for stream in container.streams)]
            text = next((tag["timecode"] for tag in tags if "timecode" in tag), None)
        if text is None:
            return None
        return parse_timecode(text, _written_rate(file) or _rate_of_frames(file))
    except (FFmpegError, OSError, CaptureError):
        return None


def parse_timecode(text: str, rate: TimecodeRate | None) -> Timecode | None:
    """Return a timecode, or None if it is invalid.

    Args:
        text: Hours, minutes, seconds and frames, as 10:15:30:12. A semicolon before the frames says that numbers are
            dropped: the first two (of 30) or four (of 60) of each minute, except of each tenth minute.
        rate: Rate of the timecode, or None if it is unknown.
    """
    found = re.fullmatch(r"(\d\d):(\d\d):(\d\d)([:;.])(\d\d\d?)", text.strip())
    if found is None or rate is None:
        return None
    hours, minutes, seconds, frames = (int(found[number]) for number in (1, 2, 3, 5))
    if hours > 23 or minutes > 59 or seconds > 59 or frames >= rate.counted:
        return None
    drops = found[4] != ":"
    number = ((hours * 60 + minutes) * 60 + seconds) * rate.counted + frames
    if drops:
        whole = hours * 60 + minutes
        number -= _dropped(rate.counted) * (whole - whole // 10)
    return Timecode(text.strip(), number, rate, drops)


def timecode_difference(one: Timecode, other: Timecode) -> float:
    """Return by how many seconds the second timecode is later, at most half a day, across midnight too.

    Timecodes of one kind are compared by the numbers of their frames. Others are compared by the time of day that they
    show, because a timecode of 29.97 frames per second without drops loses 3.6 seconds in an hour.
    """
    if one.counts_as(other):
        day = one.frames_a_day
        return _wrapped(other.number - one.number, day) / one.rate.true
    return _wrapped(other.time_of_day - one.time_of_day, DAY)


def nominal_rate(measured: float) -> TimecodeRate | None:
    """Return the rate of a timecode that counts each frame of a video, or None for a rate that no timecode counts."""
    if not 1 <= measured <= 1000:
        return None
    near = min(NOMINAL, key=lambda rate: abs(rate / measured - 1))
    counted = near if abs(near / measured - 1) < NEAR else round(measured)
    exact = next((rate for rate in (counted, counted * NTSC) if abs(rate / measured - 1) <= SAME_RATE), measured)
    return TimecodeRate(counted, exact)


def _wrapped(difference: float, day: float) -> float:
    return (difference + day / 2) % day - day / 2


def _dropped(counted: int) -> int:
    """Return the number of dropped frame numbers in a minute."""
    return round(counted / 15)


def _rate_of_frames(file: Path) -> TimecodeRate | None:
    """Return the rate of a timecode that counts a video's frames.

    Dropped frames do not count. The median gap decides where the gaps vary.
    """
    video = VideoFile(file)
    gap = float(np.median(np.diff(video.times))) if video.frames > 1 else 0.0
    if gap <= 0:
        return nominal_rate(video.fps)
    mean = frame_rate(video)
    return nominal_rate(mean if abs(mean * gap - 1) <= STEADY else 1 / gap)


def _written_rate(file: Path) -> TimecodeRate | None:
    """Return the rate that the timecode track of an MP4 or QuickTime file states, or None.

    Source: QuickTime File Format, "Timecode sample description": 4 bytes of flags, of time scale and of frame duration,
    and 1 byte with the number of frames.
    """
    if file.suffix.lower() not in SUFFIXES:
        return None
    with LOCAL.raw(file) as opened:
        tables = b"".join(_tables(opened, file.stat().st_size))
    for match in re.finditer(b"tmcd", tables):
        entry = tables[match.end() : match.end() + 25]
        if len(entry) == 25 and entry.startswith(bytes(6)):
            scale, duration, counted = struct.unpack(">16xIIB", entry)
            if duration and counted and 0.9 <= scale / duration / counted <= 1.01:
                return TimecodeRate(counted, scale / duration)
    return None


def _tables(file: BinaryIO, size: int) -> Iterator[bytes]:
    for box in top_level_boxes(file, size):
        if box.kind == b"moov" and box.end - box.start <= HEADER_BYTES:
            file.seek(box.start)
            yield file.read(box.end - box.start)
