"""Stand-ins for parts of Windows, for tests on other systems."""

import os

import pytest

from splatreel.base import atomic

fcntl = atomic.fcntl


class WindowsLocks:
    """Stand-in for the module msvcrt. Locks belong to an open file, and other handles cannot read or write what is locked."""

    LK_NBLCK = 2

    def __init__(self) -> None:
        self.positions: list[int] = []

    def locking(self, handle: int, mode: int, count: int) -> None:
        assert (mode, count) == (self.LK_NBLCK, 1)
        self.positions.append(os.lseek(handle, 0, os.SEEK_CUR))
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise PermissionError(13, "Permission denied") from error


def simulate_windows_locks(monkeypatch: pytest.MonkeyPatch) -> WindowsLocks:
    """Replace the locks of POSIX systems by those of Windows."""
    locks = WindowsLocks()
    monkeypatch.setattr(atomic, "fcntl", None)
    monkeypatch.setattr(atomic, "msvcrt", locks)
    return locks
