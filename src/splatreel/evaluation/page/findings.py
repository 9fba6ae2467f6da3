"""Sentences about what is wrong with a reel, each with a remedy where there is one."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from itertools import pairwise

from splatreel.evaluation.report import Report
from splatreel.method.prediction.quality import FAIR, rating

CAMERA_BELOW = 3.0
"""A camera stands out if its PSNR is this many dB below the median of the others."""
LOWEST = 3
"""Largest number of cameras that are named as those with the lowest PSNR."""
MOMENT_BELOW = 2.0
"""A moment fails if its PSNR is this many dB below the median of the frames."""
MOMENTS = 3
"""Largest number of moments that are named, the worst first."""
FALL = 1.0
"""Smallest fall of the PSNR in dB, between the medians of the first and the last quarter of the frames, that is worth a remark."""
FALL_FRAMES = 16
"""Smallest number of frames in which a fall is looked for."""
CODING_LOSS = 0.2
"""Loss by compression in dB that is worth a remark."""


@dataclass(frozen=True)
class Moment:
    """Consecutive frames with a low PSNR.

    Attributes:
        first: First frame.
        last: Last frame.
        below: Largest distance to the median of all frames, dB.
    """

    first: int
    last: int
    below: float


def findings(report: Report, fps: float) -> list[str]:
    """Return sentences about the quality of a reel, the general one first.

    Args:
        report: Report of an evaluation.
        fps: Frames per second, for times.
    """
    kind = "Held-out cameras" if report.held_out else "Training cameras"
    found = [f"{kind} are rendered with {report.psnr:.1f} dB, which is {rating(report.psnr)}{_lowest(report)}."]
    if not report.held_out:
        found.append("No camera was held out, so the quality of novel views was not measured.")
    found += [*_cameras(report), *_fall(report), *_moments(report, fps)]
    return [*found, *_motion(report), *_flicker(report), *_coding(report)]


def failing_moments(report: Report) -> list[Moment]:
    """Return the moments whose PSNR is far below the median, in order of time."""
    if len(report.per_frame) < 3:
        return []
    middle = statistics.median(frame["psnr"] for frame in report.per_frame)
    low = [(f["frame"], middle - f["psnr"]) for f in report.per_frame if middle - f["psnr"] >= MOMENT_BELOW]
    step = min((b["frame"] - a["frame"] for a, b in pairwise(report.per_frame)), default=1)
    moments: list[Moment] = []
    for frame, below in low:
        if moments and frame - moments[-1].last <= 2 * step:
            moments[-1] = Moment(moments[-1].first, frame, max(moments[-1].below, below))
        else:
            moments.append(Moment(frame, frame, below))
    return moments


def _lowest(report: Report) -> str:
    """Name the cameras with the lowest PSNR, where there are several."""
    if len(report.cameras) < 2:
        return ""
    order = sorted(report.cameras, key=lambda camera: camera["psnr"])[: min(LOWEST, len(report.cameras) // 2)]
    named = ", ".join(f"{camera['name']} ({camera['psnr']:.1f} dB)" for camera in order)
    return f"; lowest: {named}"


def _cameras(report: Report) -> list[str]:
    found = []
    for camera in report.cameras:
        others = [other["psnr"] for other in report.cameras if other is not camera]
        if others and (below := statistics.median(others) - camera["psnr"]) >= CAMERA_BELOW:
            found.append(
                f"Camera {camera['name']} is {below:.1f} dB below the others. Check its pose, its focus and its exposure: "
                "`splatreel capture check`."
            )
    return found


def _fall(report: Report) -> list[str]:
    """Return a sentence about a PSNR that gets lower and lower in the course of the video."""
    values = [frame["psnr"] for frame in report.per_frame]
    if len(values) < FALL_FRAMES:
        return []
    edges = [len(values) * quarter // 4 for quarter in range(5)]
    quarters = [statistics.median(values[a:b]) for a, b in pairwise(edges)]
    fall = quarters[0] - quarters[-1]
    if fall < FALL or any(later > earlier + FALL / 4 for earlier, later in pairwise(quarters)):
        return []
    return [
        f"The PSNR falls over time: the median is {quarters[0]:.1f} dB in the first quarter of the frames and {quarters[-1]:.1f} dB in "
        "the last. The light or a camera may change slowly, or more moves at the end."
    ]


def _moments(report: Report, fps: float) -> list[str]:
    worst = sorted(failing_moments(report), key=lambda moment: -moment.below)[:MOMENTS]
    found = []
    for moment in sorted(worst, key=lambda moment: moment.first):
        frames = f"Frame {moment.first}" if moment.first == moment.last else f"Frames {moment.first} to {moment.last}"
        verb = "is" if moment.first == moment.last else "are up to"
        times = f"{moment.first / fps:.2f} s" if fps else "unknown time"
        found.append(
            f"{frames} (from {times}) {verb} {moment.below:.1f} dB below the median frame. Something moves fast, appears or "
            "changes its light there."
        )
    return found


def _motion(report: Report) -> list[str]:
    value = (report.moving or {}).get("psnr")
    if value is None or value >= FAIR:
        return []
    return [
        f"Moving parts are rendered with {value:.1f} dB, which is poor. More iterations may help: `--quality paper`."
    ]


def _flicker(report: Report) -> list[str]:
    within, borders = report.flicker, report.flicker_borders
    if within is None or borders is None or borders < 1.5 * within or borders < within + 0.3:
        return []
    return [
        f"The change between groups is visible: images flicker by {borders:.2f} gray levels there, otherwise by {within:.2f}."
    ]


def _coding(report: Report) -> list[str]:
    if report.psnr_undecoded is None or (loss := report.psnr_undecoded - report.psnr) < CODING_LOSS:
        return []
    return [f"Compression costs {loss:.2f} dB. `splatreel encode --rate high` makes a larger reel with a smaller loss."]
