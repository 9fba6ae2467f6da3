"""Arrays of frames in files instead of memory, read on demand.

A group of megapixel images takes gigabytes, but a stage uses one image at a time. The system keeps as much of a mapped
file in memory as fits, and drops its pages before it kills a process for lack of memory.
"""

from __future__ import annotations

import mmap
import os
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np

SMALLEST = 256 << 20
"""Arrays of at least this many bytes are stored in a file."""
IN_MEMORY = ("tmpfs", "ramfs", "devtmpfs")
"""File systems on which a file saves no memory."""


def frame_array(shape: tuple[int, ...], smallest: int = SMALLEST) -> np.ndarray:
    """Return an uninitialized or zero uint8 array: in an unnamed file if it is large, otherwise in memory.

    The file is in the temporary folder (TMPDIR). If that folder is in memory or full, the array is in memory.
    """
    size = int(np.prod(shape, dtype=np.int64))
    folder = Path(tempfile.gettempdir())
    if size < smallest or not hasattr(mmap.mmap, "madvise") or _lies_in_memory(folder):
        return np.empty(shape, np.uint8)
    try:
        with tempfile.TemporaryFile(prefix="splatreel-frames", dir=folder) as file:
            # Allocate now: a write to a mapped file without disk space kills the process.
            os.posix_fallocate(file.fileno(), 0, size)
            mapped = mmap.mmap(file.fileno(), size)
    except OSError:
        return np.empty(shape, np.uint8)
    return np.frombuffer(mapped, np.uint8).reshape(shape)


def release_pages(array: np.ndarray) -> None:
    """Release the pages of an array's file from this process. The content stays, and arrays in memory are not affected.

    The pages stay in the system's cache while there is room, and are loaded again on access.
    """
    if (mapped := _mapped(array)) is not None:
        with suppress(OSError, ValueError):
            mapped.madvise(mmap.MADV_DONTNEED)


def is_in_file(array: np.ndarray) -> bool:
    """Return whether an array of `frame_array`, or a view of one, is stored in a file."""
    return _mapped(array) is not None


def stores_in_file(size: int) -> bool:
    """Return whether `frame_array` would store this many bytes in a file."""
    return (
        size >= SMALLEST
        and hasattr(mmap.mmap, "madvise")
        and not _lies_in_memory(folder := Path(tempfile.gettempdir()))
    ) and _room(folder) > size


def _room(folder: Path) -> int:
    try:
        found = os.statvfs(folder)
    except OSError:
        return 0
    return found.f_bavail * found.f_frsize


def _mapped(array: np.ndarray) -> mmap.mmap | None:
    base: object = array
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, memoryview):
        base = base.obj
    return base if isinstance(base, mmap.mmap) else None


def _lies_in_memory(folder: Path) -> bool:
    """Return whether a folder's file system is in memory, by the longest mount point above it."""
    try:
        mounts = [
            line.split() for line in Path("/proc/mounts").read_text(encoding="utf-8", errors="replace").splitlines()
        ]
        place = folder.resolve()
    except OSError:
        return False
    above = [(len(words[1]), words[2]) for words in mounts if len(words) > 2 and place.is_relative_to(words[1])]
    return max(above, default=(0, ""))[1] in IN_MEMORY
