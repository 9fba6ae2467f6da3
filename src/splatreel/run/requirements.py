"""Requirements that a capture must meet to be reconstructed, the memory of this machine among them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from splatreel.base import process
from splatreel.base.errors import ReconstructionError
from splatreel.base.paged_arrays import stores_in_file
from splatreel.capture.base import Capture
from splatreel.config import Config, LayeringConfig
from splatreel.method.images.flow import RAFT
from splatreel.method.layering.sam2 import SAM2

MIN_CAMERAS = 3
"""Smallest number of training cameras."""
MIN_SIDE = 8
"""Smallest side of an image in pixels. Smaller images show no features that cameras could agree on."""
BLACK, WHITE = 24, 231
"""Gray levels: an image is black if no pixel is above the first, and white if none is below the second. Both allow for noise."""


def check_capture(capture: Capture) -> None:
    """Check the number of cameras and the size of the images.

    Raises:
        ReconstructionError: The capture can be read, but not reconstructed.
    """
    count = len(capture.training_cameras)
    if count < MIN_CAMERAS:
        raise ReconstructionError(
            f"{capture.path}: only {count} cameras are left to train on besides the held-out {', '.join(capture.held_out)}; "
            f"at least {MIN_CAMERAS} are needed. Hold out fewer (--hold-out none: all are trained on), or add cameras."
        )
    if min(capture.width, capture.height) < MIN_SIDE:
        raise ReconstructionError(
            f"{capture.path}: images of {capture.width}x{capture.height} pixels are too small, each side needs at least "
            f"{MIN_SIDE}. Ask for a larger width or scale."
        )


def check_networks(config: LayeringConfig) -> None:
    """Check that the networks of layering are on this machine. They are loaded after the first keyframe only.

    Raises:
        MissingDependencyError: A package or its weights are missing.
    """
    if config.flow == "raft":
        RAFT.check()
    if config.segment == "sam2":
        SAM2.check()


def check_images(capture: Capture, names: list[str], frames: np.ndarray) -> None:
    """Check that every camera shows something.

    Args:
        capture: The capture, for the error.
        names: Names of the cameras.
        frames: Their images [T, C, H, W, 3] uint8 of some moments.

    Raises:
        ReconstructionError: All images of a camera are black or white.
    """
    black, white = (frames <= BLACK).all((0, 2, 3, 4)), (frames >= WHITE).all((0, 2, 3, 4))
    for color, blank in (("black", black), ("white", white)):
        if blank.any():
            which = [name for name, flat in zip(names, np.atleast_1d(blank), strict=True) if flat]
            some = "every camera" if len(which) == len(names) else f"camera {', '.join(which)}"
            raise ReconstructionError(
                f"{capture.path}: all images of {some} are {color}. Choose other frames (--frames A:B), or remove the camera: its "
                "video and its pose."
            )


HALVED = 0.25
"""Memory of a group's frames at half size, as a share of the frames at full size."""
PROCESS = 640e6
"""Bytes of a process with all libraries and compiled code, before it loads images of any size."""
FRAMES = 1.3
"""Bytes for each byte of the frames that are held: the frames themselves, masks, flow, and the static background of each view."""
CACHED = 0.25
"""Bytes for each byte of the frames if they are in files: what the system's cache should hold, so that training rarely waits
for the disk."""
PIXEL = 620.0
"""Bytes for each pixel of one image during a training step."""
POINT = 1500.0
"""Bytes for each point: 59 numbers with gradients and Adam moments, a copy to go back to, and temporary arrays."""
FITS = 0.8
"""Share of the memory that a recommended image size takes. Other programs need the rest."""
NARROWEST = 64
"""Smallest width in pixels that is recommended."""


def physical_memory() -> int | None:
    """Return the bytes of this machine's memory; None where the system does not tell (Windows)."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def total_memory() -> int | None:
    """Return the bytes that programs may take when nothing else runs, of the machine or of the container; None if unknown."""
    found = [room for room in (physical_memory(), process.memory_limit()) if room is not None]
    return min(found) if found else None


def free_memory() -> int | None:
    """Return the bytes that programs may still take, of the machine or of the container; None if unknown."""
    found = [room for room in (_free_of_machine(), process.free_memory()) if room is not None]
    return min(found) if found else None


def _free_of_machine() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, ValueError, StopIteration):
        return None


def needed_memory(capture: Capture, config: Config) -> int:
    """Return the largest number of bytes that a process takes to reconstruct the groups of a capture.

    If the frames are held in memory, the number is within 30 % of the peaks in `benchmarks/results.jsonl`, for images 160 to
    1352 pixels wide. Large groups are held in files of the temporary folder (`frame_array`), if it has room. Workers on other
    machines are assumed to have such a folder too.
    """
    return _needed(capture, config, capture.width, capture.height)


def check_memory(capture: Capture, config: Config) -> None:
    """Check that the images of a capture fit into this machine. A group's frames are held together with those of the next group.

    Raises:
        ReconstructionError: They do not fit. The error names a width that fits.
    """
    memory, needed = total_memory(), needed_memory(capture, config)
    if memory is None or needed <= memory:
        return
    group = config.group.length + config.group.overlap
    frames, cameras = min(2 * group, _length(capture, config)), len(capture.training_cameras)
    width = fitting_width(capture, config, FITS * memory)
    remedy = "Use a machine with more memory." if width is None else f"--width {width} fits."
    raise ReconstructionError(
        f"{capture.path}: images of {capture.width}x{capture.height} by {cameras} cameras, {frames} frames at a time, take "
        f"{needed / 2**30:.1f} GiB of memory, and this machine has {memory / 2**30:.1f}. {remedy}"
    )


def fitting_width(capture: Capture, config: Config, memory: float) -> int | None:
    """Return the largest width of images, a multiple of 16, that fits into a number of bytes; None if even small images do not fit."""
    widths = range(NARROWEST, capture.width, 16)
    heights = (round(capture.height * width / capture.width) for width in widths)
    fitting = [w for w, h in zip(widths, heights, strict=True) if _needed(capture, config, w, h) <= memory]
    return max(fitting, default=None)


def _needed(capture: Capture, config: Config, width: int, height: int) -> int:
    pixels, keyframe = width * height, config.keyframe
    points = min(keyframe.max_points, keyframe.points_per_pixel * pixels)
    frames = 3 * pixels * len(capture.training_cameras) * _held(capture, config)
    share = CACHED if stores_in_file(round(frames)) else FRAMES
    return round(PROCESS + share * frames + PIXEL * pixels + POINT * points)


def _held(capture: Capture, config: Config) -> float:
    """Return the frames of a group and of the next group, half-size copies included, counted in full-size frames."""
    group, frames = config.group.length + config.group.overlap, _length(capture, config)
    first = min(group, frames)
    copies = 2 if _has_opposite_backgrounds(capture) else 1
    return copies * first * (1 + HALVED) + min(group, frames - first)


def _has_opposite_backgrounds(capture: Capture) -> bool:
    """Return True if groups hold each image over two backgrounds (`method/train/opposite_backgrounds.py`)."""
    if not capture.backgrounds:
        return False
    from splatreel.method.init.visual_hull import is_sparse  # needs OpenCV, which `capture check` does not require

    return is_sparse(capture.training_cameras)


def _length(capture: Capture, config: Config) -> int:
    """Return the frames of a capture. A capture that grows is taken for long enough."""
    return 2 * (config.group.length + config.group.overlap) if capture.growing else capture.frames
