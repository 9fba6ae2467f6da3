"""Where numba keeps compiled kernels, also in a container whose package folder and home are read-only.

By default that is beside each source file, else in the user's cache folder. Where neither can be written, numba refuses to import a
function that is to be cached.
"""

from __future__ import annotations

import functools
import os
import stat
import sys
import tempfile
from pathlib import Path

PACKAGE = Path(__file__).parent
VARIABLE = "NUMBA_CACHE_DIR"


@functools.cache
def choose_compile_cache() -> None:
    """Have numba cache in the temporary folder where its own folders cannot be written, and not at all where that cannot be either.

    Comes before the first kernel is imported. Processes that are started from this one follow it.
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
    if "numba" in sys.modules:  # it has read the variable
        sys.modules["numba"].config.CACHE_DIR = str(private)


def _user_cache() -> Path:
    """Return the folder that numba takes for a user, about: on other systems than Linux it is elsewhere in the home."""
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))


def _writable(folder: Path) -> bool:
    """Return whether files can be made in a folder, or a folder that is missing can be made."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _private_folder() -> Path | None:
    """Return a folder of this user alone in the temporary one: what is cached is code, which nobody else may put there."""
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
    """Compile in every process anew. Numba has no setting for that."""
    from numba.core.dispatcher import Dispatcher

    Dispatcher.enable_caching = lambda self: None
