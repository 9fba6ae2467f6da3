"""Arrays of frames that lie in a file instead of in memory: they are read as they are needed.

A group of a megapixel takes gigabytes, of which a stage looks at a picture at a time. In a file that is mapped, the system keeps in
memory what there is room for, and fetches the rest again. Such pages are given up before any process is killed for want of memory.
"""

from __future__ import annotations

import mmap
import os
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np

SMALLEST = 256 << 20
"""Bytes from which on an array lies in a file."""
IN_MEMORY = ("tmpfs", "ramfs", "devtmpfs")
"""File systems on which a file saves no memory."""


def frame_array(shape: tuple[int, ...], smallest: int = SMALLEST) -> np.ndarray:
    """Return an array of uint8 with undefined or zero content: in a file without a name if it is large, else in memory.

    The file lies in the temporary folder (TMPDIR). Where that lies in memory itself, or has no room, so does the array.
    """
    size = int(np.prod(shape, dtype=np.int64))
    folder = Path(tempfile.gettempdir())
    if size < smallest or not hasattr(mmap.mmap, "madvise") or _lies_in_memory(folder):
        return np.empty(shape, np.uint8)
    try:
        with tempfile.TemporaryFile(prefix="splatreel-frames", dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, size)  # now, for a mapped file that cannot grow kills the process
            mapped = mmap.mmap(file.fileno(), size)
    except OSError:
        return np.empty(shape, np.uint8)
    return np.frombuffer(mapped, np.uint8).reshape(shape)


def give_back(array: np.ndarray) -> None:
    """Take the pages of an array's file out of this process; what it holds stays. Nothing for an array in memory.

    They stay in the system's cache as long as there is room, and come back when they are looked at.
    """
    if (mapped := _mapped(array)) is not None:
        with suppress(OSError, ValueError):
            mapped.madvise(mmap.MADV_DONTNEED)


def is_in_file(array: np.ndarray) -> bool:
    """Return whether an array of `frame_array`, or a part of one, lies in a file."""
    return _mapped(array) is not None


def frames_lie_in_files(size: int) -> bool:
    """Return whether `frame_array` would put so many bytes into a file."""
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
    """Return whether a folder's file system is one of memory, by the longest mount point above it."""
    try:
        mounts = [
            line.split() for line in Path("/proc/mounts").read_text(encoding="utf-8", errors="replace").splitlines()
        ]
        place = folder.resolve()
    except OSError:
        return False
    above = [(len(words[1]), words[2]) for words in mounts if len(words) > 2 and place.is_relative_to(words[1])]
    return max(above, default=(0, ""))[1] in IN_MEMORY
