"""When a capture that is still being written ends: its end mark, or nothing new for some time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

END = "splatreel.end"
"""A file of this name in the capture's folder says that nothing more comes."""
POLL = 0.1
"""Seconds between two looks at what is being written."""


def is_recorded(folder: Path) -> bool:
    """Return whether a folder holds a capture that was written to be followed, and that has ended."""
    return (folder / END).exists()


class Growth:
    """Whether more is to come, asked and told by several threads.

    folder: of the capture. timeout: seconds without anything new, told by `grew`, after which it is taken for ended.
    """

    def __init__(self, folder: Path, timeout: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.folder, self.timeout, self.clock = folder, timeout, clock
        self._grown = clock()
        self._stop = threading.Event()
        self._why: str | None = None
        self._lock = threading.Lock()

    def grew(self) -> None:
        """Something new is there, in all cameras."""
        self._grown = self.clock()

    def stop(self) -> None:
        """Nobody wants more: who waits goes on, and finds that it ended."""
        self._stop.set()

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    @property
    def quiet(self) -> float:
        """Seconds since something new was there."""
        return self.clock() - self._grown

    @property
    def why(self) -> str | None:
        """Why it ended, as a sentence; None as long as more may come. What was written before is there when it is told."""
        with self._lock:
            if self._why is None:
                if (self.folder / END).exists():
                    self._why = f"{self.folder / END} says that the capture is complete."
                elif self.quiet > self.timeout:
                    self._why = f"Nothing new was written for {self.timeout:g} s (--follow-timeout)."
            return self._why

    @property
    def ended(self) -> bool:
        return self.stopped or self.why is not None

    @classmethod
    def over(cls, folder: Path) -> Growth:
        """Return that of a capture of which nothing more comes."""
        growth = cls(folder, 0.0)
        growth._why = "The capture is complete."
        return growth

    def pause(self, seconds: float = POLL) -> None:
        """Wait a little, or until nobody wants more."""
        self._stop.wait(seconds)
