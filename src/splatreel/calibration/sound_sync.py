"""Alignment of videos by their sound, and the time that sound takes to the cameras."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from splatreel.base.errors import CaptureError, SplatreelError
from splatreel.calibration.calibration_files import is_in_meters
from splatreel.calibration.clocks import Lag, fit_lag, significant_drift
from splatreel.capture.capture_sound import RATE as SOUND_RATE
from splatreel.capture.capture_sound import channels, read_sound
from splatreel.capture.growing_video import read_packets
from splatreel.capture.growth import Growth
from splatreel.capture.pose_checks import MOST, meeting_point
from splatreel.capture.readers.calibrated import IN_METERS, is_calibrated, read_calibration
from splatreel.capture.readers.colmap import is_colmap, model_views
from splatreel.capture.segmented_video import SegmentedVideo, numbered, segment_files
from splatreel.scene.camera import Camera

RATE = 8000
"""Samples per second; enough for claps, steps and voices, with a resolution of an eighth of a millisecond."""
LONGEST = 180
"""Maximum seconds of a video that are used."""
APART = 0.05
"""Minimum distance in seconds of a rival alignment from the best one."""
CLEAR = 2.0
"""Minimum ratio between the best alignment and its best rival."""
PART = 4.0
"""Seconds of a part. A clock that is 0.1 % fast moves by 4 milliseconds in it."""
PARTS = 20
"""Maximum number of parts that are compared."""
REACH = 0.5
"""Seconds around the lag of whole tracks at which parts are searched."""
CLEAR_PART = 1.5
"""Minimum ratio between the best lag of a part and its best rival."""
ON_LINE = 0.003
"""Maximum distance in seconds of a part's lag from a drift."""
SEARCHED = 0.25
"""Minimum share of the parts on one line, where parts were searched in a whole track."""


@dataclass(frozen=True)
class Agreement:
    """Alignment of two videos: the second started `later` seconds after the first. `clear` is its ratio to the best rival."""

    later: float
    clear: float


def listen(file: Path) -> np.ndarray | None:
    """Return the sound of a video, or of a folder of its parts, from its first frame on, or None without sound.

    Returns:
        Sound [samples] float32 at `RATE`.
    """
    files = segment_files(file) if file.is_dir() else [file]
    names = numbered(files) if len(files) > 1 else None
    video = None if names is None else SegmentedVideo(file, names, Growth.over(file.parent))
    file = files[0] if video is None else video.written
    if not channels(file):
        return None
    rate = RATE if video is None else SOUND_RATE
    parts, count = [], 0
    try:
        for block in read_sound(file, 1, RATE) if video is None else read_packets(video.sound(), 1, 0.0):
            parts.append(block[:, 0])
            count += len(block)
            if count >= LONGEST * rate:
                break
    except CaptureError:
        if not parts:  # the sound of a truncated video is used up to its end
            raise
    sound, step = np.concatenate([np.zeros(0, np.float32), *parts])[: LONGEST * rate], rate // RATE
    return sound[: len(sound) // step * step].reshape(-1, step).mean(1)


def common_length(sounds: dict[str, np.ndarray]) -> int:
    """Return the length of the transforms that compare any two sounds."""
    return 1 << (2 * max(map(len, sounds.values())) - 1).bit_length()


def phases(sound: np.ndarray, length: int) -> np.ndarray:
    """Return the spectrum without amplitudes, so that sounds loud at one camera count no more than others."""
    spectrum = np.fft.rfft(sound, length)
    return (spectrum / np.maximum(np.abs(spectrum), 1e-12)).astype(np.complex64)


def compare(a: np.ndarray, b: np.ndarray, length: int) -> Agreement:
    """Return the best alignment of two sounds, given their phases."""
    fit = np.fft.irfft(a * np.conj(b), length)
    best = int(fit.argmax())
    rivals = np.roll(fit, -best)
    away = round(APART * RATE)
    clear = fit[best] / max(rivals[away:-away].max(), 1e-12)
    return Agreement((best if best < length // 2 else best - length) / RATE, float(clear))


def align_drifting(a: np.ndarray, b: np.ndarray, later: float, least: float) -> tuple[Lag, Agreement] | None:
    """Return the lag of two sounds whose clocks run at different speeds, or None for clocks of one speed.

    Args:
        a: Sound of the first video, [samples].
        b: Sound of the second video, [samples].
        later: Lag of the whole sounds, seconds.
        least: Minimum change of the lag, in seconds.
    """
    line = significant_drift(*_near_lags(a, b, later), ON_LINE, PART / 2, least)
    return None if line is None else _refine(a, b, line.drift)


def search_parts(a: np.ndarray, b: np.ndarray) -> tuple[Lag, Agreement] | None:
    """Return the lag of two sounds by where parts of the first one are in the second one, or None if few parts agree.

    This finds sounds whose clocks drift so much that whole tracks do not fit.
    """
    found = [(at / RATE + PART / 2, at / RATE - _locate(part, b).later) for at, part in _parts(a, 0.0, len(a) / RATE)]
    times, lags = np.array(found).reshape(-1, 2).T
    line = fit_lag(times, lags, ON_LINE, PART / 2, SEARCHED)
    refined = None if line is None else _refine(a, b, line.drift)
    return refined if refined is not None and refined[1].clear >= CLEAR else None


def _refine(a: np.ndarray, b: np.ndarray, drift: float) -> tuple[Lag, Agreement]:
    """Return the lag of two sounds from about its drift: `b` is resampled to the clock of `a`, and compared again."""
    for last in (False, False, True):
        even = np.interp(np.arange(round(len(b) / (1 - drift))) * (1 - drift), np.arange(len(b)), b).astype(np.float32)
        length = common_length({"a": a, "b": even})
        found = compare(phases(a, length), phases(even, length), length)
        rest = None if last else fit_lag(*_near_lags(a, even, found.later), ON_LINE, PART / 2)
        if rest is None:
            break
        drift = 1 - (1 - drift) * (1 - rest.drift)
    return Lag((1 - drift) * found.later, drift), found


def _near_lags(a: np.ndarray, b: np.ndarray, later: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the times of parts of `a`, [N] seconds, and their clear lags near that of the whole sounds, [N] seconds."""
    times, lags = [], []
    reach = round(REACH * RATE)
    for at, part in _parts(a, max(later, 0.0), min(len(a) / RATE, later + len(b) / RATE)):
        begin = max(at - round(later * RATE) - reach, 0)
        found = _locate(part, b[begin : begin + len(part) + 2 * reach])
        if found.clear >= CLEAR_PART:
            times.append(at / RATE + PART / 2)
            lags.append((at - begin) / RATE - found.later)
    return np.array(times), np.array(lags)


def _parts(sound: np.ndarray, first: float, last: float) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the first sample and the samples of parts between two times."""
    room = last - first - PART
    if room <= 0:
        return
    for time in np.linspace(first, last - PART, min(int(room / PART) + 2, PARTS)):
        at = round(float(time) * RATE)
        yield at, sound[at : at + round(PART * RATE)]


def _locate(part: np.ndarray, sound: np.ndarray) -> Agreement:
    """Return where a part begins in a sound, in seconds, and how clear this is."""
    length = 1 << (len(part) + len(sound)).bit_length()
    found = compare(phases(sound, length), phases(part, length), length)
    return replace(found, later=found.later + length / RATE) if found.later < -PART else found


SPEED = 343.0
"""Speed of sound in meters per second, in dry air of 20 degrees."""
EXAMPLE = 10.0
"""Meters of the example in `describe_unknown_travel`."""


@dataclass(frozen=True)
class SoundTravel:
    """Time that sound takes from the place that the cameras look at.

    Attributes:
        most: Maximum difference between two cameras for a sound anywhere, in seconds.
    """

    seconds: dict[str, float]
    most: float

    def describe(self) -> str:
        """Return a sentence about the correction."""
        near, far = min(self.seconds.values()), max(self.seconds.values())
        return (
            f"sound takes {1000 / SPEED:.1f} ms a meter. This is corrected, by up to {1000 * (far - near):.1f} ms, for a sound at the "
            f"place that the cameras look at, {SPEED * near:.1f} to {SPEED * far:.1f} m away. A sound elsewhere shifts two cameras by "
            f"up to {1000 * self.most:.0f} ms"
        )


def describe_unknown_travel(frame: float) -> str:
    """Return a sentence about what the time that sound takes may amount to. `frame` is the duration of a frame in seconds."""
    late = EXAMPLE / SPEED
    return (
        f"sound takes {1000 / SPEED:.1f} ms a meter. This is not corrected, since the places of the cameras are not known in meters: a "
        f"camera {EXAMPLE:g} m farther from the sound than others seems {1000 * late:.0f} ms ({late / frame:.1f} frames) late. "
        f"Calibrate in meters (--board, --scale-board or --distance) and run this again, or leave it to `reconstruct`, which learns up "
        f"to 1.5 frames for each camera"
    )


def sound_travel(path: Path, names: Iterable[str]) -> SoundTravel | None:
    """Return the time that sound takes to some cameras; None if a place is unknown, or not in meters, or the cameras look nowhere."""
    try:
        cameras = {camera.name: camera for camera in _metric_cameras(path)}
    except SplatreelError:  # `capture check` reports what is wrong with the poses
        return None
    if not cameras or any(name not in cameras for name in names):
        return None
    meeting = meeting_point(list(cameras.values()))
    if meeting is None or meeting.before <= MOST:
        return None
    seconds = dict(zip(cameras, (meeting.distances / SPEED).tolist(), strict=True))
    centers = np.stack([cameras[name].center for name in names])
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=-1).max()
    return SoundTravel({name: seconds[name] for name in names}, float(apart) / SPEED)


def _metric_cameras(path: Path) -> list[Camera]:
    """Return the cameras of a capture whose unit is a meter; none of another capture."""
    if is_colmap(path):
        return model_views(path) if is_in_meters(path) else []
    if not is_calibrated(path):
        return []
    layout, rig = read_calibration(path)
    lens = np.array([[1.0, 0, 1], [0, 1, 1], [0, 0, 1]])
    return [Camera(view.name, view.viewmat, lens, 2, 2) for view in rig.cameras] if layout in IN_METERS else []
