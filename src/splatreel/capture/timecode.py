"""Timecodes of videos: the time of day at which a synchronized camera says that it started."""

from __future__ import annotations

import re
from pathlib import Path

import av
from av.error import FFmpegError

DAY = 86400.0
"""Seconds after which a timecode starts again."""


def read_timecode(file: Path) -> float | None:
    """Return the timecode of a video's first frame in seconds, or None if the video has none that is valid."""
    try:
        with av.open(str(file)) as container:
            pictures = container.streams.video[0]
            tags = [container.metadata, *(stream.metadata for stream in container.streams)]
            text = next((tag["timecode"] for tag in tags if "timecode" in tag), None)
            rate = float(pictures.average_rate or 0)
    except (FFmpegError, OSError, IndexError):
        return None
    return None if text is None else parse_timecode(text, rate)


def parse_timecode(text: str, rate: float) -> float | None:
    """Return a timecode as seconds, or None if it is invalid.

    Args:
        text: Hours, minutes, seconds and frames, as 10:15:30:12. A semicolon before the frames says that numbers are
            dropped: the first two (of 30) or four (of 60) of each minute, except of each tenth minute.
        rate: Frames per second of the video.
    """
    found = re.fullmatch(r"(\d\d):(\d\d):(\d\d)([:;.])(\d\d)", text.strip())
    counted = round(rate)
    if found is None or counted < 1:
        return None
    hours, minutes, seconds, frames = (int(found[number]) for number in (1, 2, 3, 5))
    if hours > 23 or minutes > 59 or seconds > 59 or frames >= counted:
        return None
    number = ((hours * 60 + minutes) * 60 + seconds) * counted + frames
    if found[4] != ":":
        whole = hours * 60 + minutes
        number -= round(counted / 15) * (whole - whole // 10)
    return number / rate


def timecode_difference(one: float, other: float) -> float:
    """Return by how many seconds the second timecode is later, at most half a day, across midnight too."""
    return (other - one + DAY / 2) % DAY - DAY / 2
