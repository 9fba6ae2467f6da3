"""Whether the frames of a capture fit into this machine: who runs out of memory is killed, and told nothing."""

from __future__ import annotations

import math
import os

from splatreel.capture.base import Capture
from splatreel.errors import ReconstructionError

HALVED = 0.25
"""Of a group's frames, the share that they take once more at half size."""
FOR_FRAMES = 0.4
"""Share of the memory that frames may take where a size is recommended: points, views and other programs want the rest."""


def physical_memory() -> int | None:
    """Bytes of this machine's memory; None where the system does not tell (Windows)."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def check_memory(capture: Capture, group: int) -> None:
    """Raises `ReconstructionError` for pictures too large, and says which fit. group: frames of one, overlap included.

    A group's frames are in memory with those of the next one, and at half size.
    """
    memory = physical_memory()
    frames = 2 * group if capture.growing else capture.frames
    first = min(group, frames)
    following = min(group, frames - first)
    cameras = len(capture.training_cameras)
    needed = 3 * capture.width * capture.height * cameras * (first * (1 + HALVED) + following)
    if memory is None or needed <= memory:
        return
    width = int(capture.width * math.sqrt(FOR_FRAMES * memory / needed)) // 16 * 16
    raise ReconstructionError(
        f"{capture.path}: pictures of {capture.width}x{capture.height} by {cameras} cameras take {needed / 2**30:.0f} GiB of "
        f"memory, {first + following} frames at a time, and this machine has {memory / 2**30:.0f}. --width {width} fits."
    )
