"""End of a growing capture: its end mark, or no new data for some time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

END = "splatreel.end"
"""Name of the file in the capture's folder that marks its end."""
POLL = 0.1
"""Seconds between checks for new data."""


def is_recorded(folder: Path) -> bool:
    """Return whether a folder holds a finished capture that was written to be followed."""
    return (folder / END).exists()


class Growth:
    """State of a growing capture, shared by several threads.

    Args:
        folder: Folder of the capture.
        timeout: Seconds without new data (`grew`) after which the capture counts as ended.
        clock: Function that returns seconds.
    """

    def __init__(self, folder: Path, timeout: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.folder = folder
        self.timeout = timeout
        self.clock = clock
        self._grown = clock()
        self._stop = threading.Event()
        self._why: str | None = None
        self._lock = threading.Lock()

    def grew(self) -> None:
        """Record new data in all cameras."""
        self._grown = self.clock()

    def stop(self) -> None:
        """Stop following. Waiting threads continue and see the end of the capture."""
        self._stop.set()

    @property
    def stopped(self) -> bool:
        """True if following was stopped."""
        return self._stop.is_set()

    @property
    def quiet(self) -> float:
        """Seconds since the last new data."""
        return self.clock() - self._grown

    @property
    def why(self) -> str | None:
        """Reason of the end as a sentence, or None while the capture grows. Data written before the end exists by then."""
        with self._lock:
            if self._why is None:
                if (self.folder / END).exists():
                    self._why = f"{self.folder / END} says that the capture is complete."
                elif self.quiet > self.timeout:
                    self._why = f"Nothing new was written for {self.timeout:g} s (--follow-timeout)."
            return self._why

    @property
    def ended(self) -> bool:
        """True if the capture has ended or following was stopped."""
        return self.stopped or self.why is not None

    @classmethod
    def over(cls, folder: Path) -> Growth:
        """Return the state of a finished capture."""
        growth = cls(folder, 0.0)
        growth._why = "The capture is complete."
        return growth

    def pause(self, seconds: float = POLL) -> None:
        """Wait briefly, or until following is stopped."""
        self._stop.wait(seconds)
