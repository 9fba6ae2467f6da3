"""Whether the frames of a capture fit into this machine: who runs out of memory is killed, and told nothing."""

from __future__ import annotations

import math
import os
from pathlib import Path

from splatreel.capture.base import Capture
from splatreel.errors import ReconstructionError

HALVED = 0.25
"""Of a group's frames, the share that they take once more at half size."""
FOR_FRAMES = 0.4
"""Share of the memory that frames may take where a size is recommended: points, views and other programs want the rest."""
PROCESS = 1 << 30
"""Bytes of a process that has loaded all libraries and compiled code, about."""


def physical_memory() -> int | None:
    """Bytes of this machine's memory; None where the system does not tell (Windows)."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def free_memory() -> int | None:
    """Bytes that programs may still take, of the machine or of the container that this one runs in; None where nobody tells."""
    found = [room for room in (_free_of_machine(), _free_of_container()) if room is not None]
    return min(found) if found else None


def _free_of_machine() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, ValueError, StopIteration):
        return None


def _free_of_container() -> int | None:
    """By control groups, version 2: what the limit leaves, and pages of files, which are given up first."""
    folder = Path("/sys/fs/cgroup")
    try:
        most, held = (int((folder / f"memory.{name}").read_text(encoding="ascii")) for name in ("max", "current"))
        lines = (folder / "memory.stat").read_text(encoding="ascii").splitlines()
        files = sum(int(line.split()[1]) for line in lines if line.startswith(("inactive_file ", "active_file ")))
    except (OSError, ValueError):  # there is no limit, or no control group
        return None
    return max(most - held + files, 0)


def needed_memory(capture: Capture, group: int) -> int:
    """Bytes that a process takes which reconstructs groups of so many frames, about: it is seen how much it does take."""
    return PROCESS + round(_of_frames(capture, group) / FOR_FRAMES)


def check_memory(capture: Capture, group: int) -> None:
    """Raises `ReconstructionError` for pictures too large, and says which fit. group: frames of one, overlap included.

    A group's frames are in memory with those of the next one, and at half size.
    """
    memory, cameras, needed = physical_memory(), len(capture.training_cameras), _of_frames(capture, group)
    if memory is None or needed <= memory:
        return
    width = int(capture.width * math.sqrt(FOR_FRAMES * memory / needed)) // 16 * 16
    frames = min(2 * group, _length(capture, group))
    raise ReconstructionError(
        f"{capture.path}: pictures of {capture.width}x{capture.height} by {cameras} cameras take {needed / 2**30:.0f} GiB of "
        f"memory, {frames} frames at a time, and this machine has {memory / 2**30:.0f}. --width {width} fits."
    )


def _of_frames(capture: Capture, group: int) -> float:
    """Bytes of a group's frames, and those of the next one."""
    frames = _length(capture, group)
    first = min(group, frames)
    following = min(group, frames - first)
    return 3 * capture.width * capture.height * len(capture.training_cameras) * (first * (1 + HALVED) + following)


def _length(capture: Capture, group: int) -> int:
    """Frames; of a capture that grows there will be enough."""
    return 2 * group if capture.growing else capture.frames
