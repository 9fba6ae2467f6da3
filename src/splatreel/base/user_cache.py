"""Small files that this user's processes share and can lose: compiled kernels of GPUs, and measured speeds."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

from splatreel.base import atomic
from splatreel.base.errors import StorageError


def folder() -> Path:
    """Return the cache folder of this program for the user, which may not exist."""
    if sys.platform == "win32":
        home = os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/AppData/Local")
    elif sys.platform == "darwin":
        home = os.path.expanduser("~/Library/Caches")
    else:
        home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(home) / "splatreel"


def load(name: str) -> bytes | None:
    """Return the content of a file; None if there is none that can be read."""
    try:
        return (folder() / name).read_bytes()
    except OSError:
        return None


def save(name: str, data: bytes) -> None:
    """Write a file, if the folder can be written to."""
    path = folder() / name
    with contextlib.suppress(OSError, StorageError):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        atomic.write_bytes(path, data)
