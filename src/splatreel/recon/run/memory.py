"""Whether a reconstruction fits into this machine: who runs out of memory is killed, and told nothing."""

from __future__ import annotations

import os
from pathlib import Path

from splatreel import cgroups
from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.errors import ReconstructionError

HALVED = 0.25
"""Of a group's frames, the share that they take once more at half size."""
PROCESS = 640e6
"""Bytes of a process that has loaded all libraries and compiled code, and works with few and small pictures."""
FRAMES = 1.3
"""Bytes for each one of the frames that are held: masks, flow, and what the static points of each view look like."""
PIXEL = 620.0
"""Bytes for each pixel of one picture, while a step is trained."""
POINT = 1500.0
"""Bytes for each point: 59 numbers and their gradients, what Adam knows of them, a copy to go back to, and what is passing."""
FITS = 0.8
"""Share of the memory that a recommended size takes: other programs want the rest."""
NARROWEST = 64
"""Pixels across, below which no width is recommended."""


def physical_memory() -> int | None:
    """Bytes of this machine's memory; None where the system does not tell (Windows)."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def total_memory() -> int | None:
    """Bytes that programs may take when nothing else runs, of the machine or of the container; None where nobody tells."""
    found = [room for room in (physical_memory(), cgroups.memory_limit()) if room is not None]
    return min(found) if found else None


def free_memory() -> int | None:
    """Bytes that programs may still take, of the machine or of the container that this one runs in; None where nobody tells."""
    found = [room for room in (_free_of_machine(), cgroups.free_memory()) if room is not None]
    return min(found) if found else None


def _free_of_machine() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, ValueError, StopIteration):
        return None


def needed_memory(capture: Capture, config: Config) -> int:
    """Bytes that a process takes at most which reconstructs the groups of a capture.

    Within 30 % of the peaks in `benchmarks/results.jsonl`, 160 to 1352 pixels wide.
    """
    return _needed(capture, config, capture.width, capture.height)


def check_memory(capture: Capture, config: Config) -> None:
    """Raises `ReconstructionError` for pictures too large for this machine, and says which fit.

    A group's frames are in memory with those of the next one, and at half size.
    """
    memory, needed = total_memory(), needed_memory(capture, config)
    if memory is None or needed <= memory:
        return
    group = config.group.length + config.group.overlap
    frames, cameras = min(2 * group, _length(capture, config)), len(capture.training_cameras)
    width = fitting_width(capture, config, FITS * memory)
    remedy = "Use a machine with more memory." if width is None else f"--width {width} fits."
    raise ReconstructionError(
        f"{capture.path}: pictures of {capture.width}x{capture.height} by {cameras} cameras, {frames} frames at a time, take "
        f"{needed / 2**30:.1f} GiB of memory, and this machine has {memory / 2**30:.1f}. {remedy}"
    )


def fitting_width(capture: Capture, config: Config, memory: float) -> int | None:
    """The largest width of pictures, a multiple of 16, with which so many bytes do; None where not even small ones do."""
    widths = range(NARROWEST, capture.width, 16)
    heights = (round(capture.height * width / capture.width) for width in widths)
    fitting = [w for w, h in zip(widths, heights, strict=True) if _needed(capture, config, w, h) <= memory]
    return max(fitting, default=None)


def _needed(capture: Capture, config: Config, width: int, height: int) -> int:
    pixels, keyframe = width * height, config.keyframe
    points = min(keyframe.max_points, keyframe.points_per_pixel * pixels)
    frames = 3 * pixels * len(capture.training_cameras) * _held(capture, config)
    return round(PROCESS + FRAMES * frames + PIXEL * pixels + POINT * points)


def _held(capture: Capture, config: Config) -> float:
    """Frames of a group, and those of the next one, in frames of full size."""
    group, frames = config.group.length + config.group.overlap, _length(capture, config)
    first = min(group, frames)
    return first * (1 + HALVED) + min(group, frames - first)


def _length(capture: Capture, config: Config) -> int:
    """Frames; of a capture that grows there will be enough."""
    return 2 * (config.group.length + config.group.overlap) if capture.growing else capture.frames
