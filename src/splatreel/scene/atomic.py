"""Atomic writes of files, and temporary folders that are removed even where the program was killed.

What is being written has a name that nobody can guess, is created by nobody else before, and is locked: what a killed program left
has no lock, and the next one removes it.
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
except ImportError:  # not on Windows, where nothing keeps two programs apart
    fcntl = None

_LEFT = re.compile(r"\..*\.[0-9a-f]{16}\.tmp")
_LONGEST = 100
"""Characters of a file's name that the temporary one has as well."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new, empty file beside `path`; at the end it takes the place of `path`, after an exception it is deleted. Raises OSError."""
    temporary = _temporary(path.parent, path.name)
    try:
        handle = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    except OSError as error:
        error.filename = str(path)  # the name that a user knows
        raise
    try:
        try:
            lock(handle)
            yield temporary
            os.fsync(handle)
            if fcntl is not None:  # while it is locked
                os.replace(temporary, path)
        finally:
            os.close(handle)
        if fcntl is None:  # what is open cannot be moved there
            os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all. Raises `GaussiansError` if it cannot be written."""
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(data)
    except OSError as error:
        raise GaussiansError(
            f"{path}: could not be written ({error.strerror}). Free space or choose a path."
        ) from error


@contextmanager
def scratch(folder: Path, name: str) -> Iterator[Path]:
    """A new folder in `folder` to work in, which is deleted at the end, with those of this name that killed programs left."""
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
    """Remove what killed programs left half made in a folder, of this name or of all."""
    if fcntl is None:
        return
    for path in folder.glob(".*.tmp"):
        if _LEFT.fullmatch(path.name) and path.name.startswith(f".{name[:_LONGEST]}") and not path.is_symlink():
            _remove_unlocked(path)


def lock(handle: int) -> bool:
    """Lock an open file or folder, until it is closed; False where another program has. Where nothing can be locked, True."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True  # some network file systems have no locks: then nobody can tell
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
