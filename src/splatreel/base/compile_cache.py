"""The folder in which numba caches compiled kernels, also in a container whose package folder and home are read-only.

By default numba caches beside each source file, else in the user's cache folder. If neither is writable, numba raises an error when a
cached function is imported.
"""

from __future__ import annotations

import functools
import os
import stat
import sys
import tempfile
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
VARIABLE = "NUMBA_CACHE_DIR"


@functools.cache
def choose_compile_cache() -> None:
    """Choose a writable folder for numba's cache: numba's own, else one in the temporary folder, else turn the cache off.

    Call this before the first kernel is imported. Child processes inherit the choice.
    """
    chosen = os.environ.get(VARIABLE)
    if chosen and _writable(Path(chosen)):
        return
    if not chosen and (_writable(PACKAGE / "__pycache__") or _writable(_user_cache())):
        return
    private = _private_folder()
    if private is None:
        _cache_nothing()
        return
    os.environ[VARIABLE] = str(private)
    if "numba" in sys.modules:  # numba has read the variable already
        sys.modules["numba"].config.CACHE_DIR = str(private)


def _user_cache() -> Path:
    """Return numba's cache folder for the user on Linux. On other systems it is elsewhere in the home folder."""
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))


def _writable(folder: Path) -> bool:
    """Return whether files can be created in a folder, or whether a missing folder can be created."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _private_folder() -> Path | None:
    """Return a folder in the temporary folder that only this user can write to, since the cache holds code; None if impossible."""
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    try:
        folder = Path(tempfile.gettempdir()) / f"splatreel-numba-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    mine = not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not found.st_mode & 0o077)
    return folder if mine and stat.S_ISDIR(found.st_mode) and _writable(folder) else None


def _cache_nothing() -> None:
    """Turn numba's cache off: every process compiles anew. Numba has no setting for this, so its method is replaced."""
    from numba.core.dispatcher import Dispatcher

    Dispatcher.enable_caching = lambda self: None
