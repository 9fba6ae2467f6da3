"""Atomic file writes and moves, locks, and temporary folders that are removed even if the program is killed.

A temporary file has a random name, is created exclusively and is locked. A killed program releases its lock, so the
next program can remove what it left. Windows cannot move or delete files that another program has open, so moves and
deletions are tried again there.
"""

from __future__ import annotations

import importlib
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from splatreel.base.errors import GaussiansError


def _import(name: str) -> Any:
    """Return a module that some systems lack, or None."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


fcntl, msvcrt = _import("fcntl"), _import("msvcrt")
"""Locks of POSIX systems, and of Windows."""

_LEFT = re.compile(r"\..*\.[0-9a-f]{16}\.tmp")
_LONGEST = 100
"""Characters of the file's name that are kept in the temporary name."""
_IN_USE = (5, 32)
"""Errors of Windows for a file that another program has open: access denied, sharing violation."""
_TRIES, _FIRST_WAIT, _LONGEST_WAIT = 25, 0.01, 0.5
"""Attempts to move or delete such a file, and the seconds before the second attempt and at most between two."""
_LOCKED_BYTE = (1 << 31) - 2
"""Position of the byte that stands for a file in the locks of Windows. Other programs cannot read or write a locked byte, so the byte
is beyond the end of the file."""


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
                move(temporary, path)
        finally:
            os.close(handle)
        if fcntl is None:  # Windows cannot move an open file
            move(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def move(source: Path, target: Path) -> None:
    """Move a file or folder, replacing a file that is there.

    Raises:
        OSError: It cannot be moved, or another program on Windows keeps one of the two open.
    """
    _until_closed(lambda: os.replace(source, target))


def remove(path: Path) -> None:
    """Delete a file if it exists.

    Raises:
        OSError: It cannot be deleted, or another program on Windows keeps it open.
    """
    _until_closed(lambda: path.unlink(missing_ok=True))


def _until_closed(act: Callable[[], None]) -> None:
    """Act on a file. Try again while another program on Windows, such as a server, has the file open."""
    wait = _FIRST_WAIT
    for attempt in range(_TRIES):
        try:
            return act()
        except PermissionError as error:
            if getattr(error, "winerror", None) not in _IN_USE or attempt == _TRIES - 1:
                raise
        time.sleep(wait)
        wait = min(2 * wait, _LONGEST_WAIT)


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
    """Lock an open file, or on other systems than Windows a folder, until it is closed.

    Returns:
        False if another program holds the lock. True also where locks are not supported.
    """
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        elif msvcrt is not None:
            os.lseek(handle, _LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
            os.lseek(handle, 0, os.SEEK_SET)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True  # some network file systems have no locks
    return True


def open_lock(folder: Path) -> int:
    """Return a handle by which `lock` locks a folder.

    Windows opens no folders. Its locks are on a file beside the folder, which disappears when the handle is closed.
    """
    if fcntl is not None:
        return os.open(folder, os.O_RDONLY)
    beside = folder.parent / f".{folder.name[:_LONGEST]}.lock"
    return os.open(beside, os.O_RDWR | os.O_CREAT | getattr(os, "O_TEMPORARY", 0), 0o644)


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
