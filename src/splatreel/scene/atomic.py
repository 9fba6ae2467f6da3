"""Atomic file writes, and temporary folders that are removed even if the program is killed.

A temporary file has a random name, is created exclusively and is locked. A killed program releases its lock, so the
next program can remove what it left.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splatreel.errors import GaussiansError

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None

_LEFT = re.compile(r"\..*\.[0-9a-f]{16}\.tmp")
_LONGEST = 100
"""Characters of the file's name that are kept in the temporary name."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a new empty file beside `path`, which replaces `path` on success and is deleted on error.

    Raises:
        OSError: The file cannot be created or moved.
    """
    temporary = _temporary(path.parent, path.name)
    try:
        handle = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    except OSError as error:
        error.filename = str(path)  # report the user's file, not the temporary one
        raise
    try:
        try:
            lock(handle)
            yield temporary
            os.fsync(handle)
            if fcntl is not None:  # move it while it is locked
                os.replace(temporary, path)
        finally:
            os.close(handle)
        if fcntl is None:  # Windows cannot move an open file
            os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file completely or not at all.

    Raises:
        GaussiansError: The file cannot be written.
    """
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(data)
    except OSError as error:
        raise GaussiansError(
            f"{path}: could not be written ({error.strerror}). Free space or choose a path."
        ) from error


@contextmanager
def scratch(folder: Path, name: str) -> Iterator[Path]:
    """Yield a new temporary folder in `folder` and delete it at the end.

    Folders of the same name that killed programs left are deleted first.
    """
    sweep(folder, name)
    place = _temporary(folder, name)
    place.mkdir()
    handle = os.open(place, os.O_RDONLY) if fcntl is not None else None
    try:
        if handle is not None:
            lock(handle)
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)
        if handle is not None:
            os.close(handle)


def sweep(folder: Path, name: str = "") -> None:
    """Delete temporary files and folders that killed programs left in a folder.

    Args:
        folder: Folder to clean.
        name: Only temporary files of this name; empty means all.
    """
    if fcntl is None:
        return
    for path in folder.glob(".*.tmp"):
        if _LEFT.fullmatch(path.name) and path.name.startswith(f".{name[:_LONGEST]}") and not path.is_symlink():
            _remove_unlocked(path)


def lock(handle: int) -> bool:
    """Lock an open file or folder until it is closed.

    Returns:
        False if another program holds the lock. True also where locks are not supported.
    """
    if fcntl is None:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True  # some network file systems have no locks
    return True


def _temporary(folder: Path, name: str) -> Path:
    return folder / f".{name[:_LONGEST]}.{secrets.token_hex(8)}.tmp"


def _remove_unlocked(path: Path) -> None:
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
    except OSError:
        return
    try:
        if lock(handle):
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
    finally:
        os.close(handle)
