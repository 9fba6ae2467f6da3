"""Sample the memory of a process and its children in a thread while something runs."""

import os
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Self

PAGE = os.sysconf("SC_PAGE_SIZE")
INTERVAL, INTERVAL_OF_CHILDREN = 0.05, 0.2
"""Seconds between samples; children are looked for among all processes, which takes longer."""


class Resident:
    """Resident memory in bytes during a `with` block, on Linux. with_children: add the memory of child processes.

    A page that several processes share, such as of a library, counts for each.
    """

    def __init__(self, with_children: bool = False) -> None:
        self.samples: list[tuple[float, int]] = []
        """(seconds since the epoch, bytes)"""
        self._with_children = with_children
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def peak(self) -> int:
        """Return the maximum of all samples and of the peak that the system reports."""
        return max(most_of_this_process(), *(held for _, held in self.samples))

    def peaks(self, ends: Sequence[float]) -> list[int]:
        """Return the peak within each interval, [G]; 0 for an interval without a sample.

        Args:
            ends: End of each interval, seconds since the epoch. Each begins where the last one ended.
        """
        found, begin = [], 0.0
        for end in ends:
            found.append(max((held for at, held in self.samples if begin < at <= end), default=0))
            begin = end
        return found

    def _watch(self) -> None:
        own = str(os.getpid())
        while True:
            held = [resident_of(pid) for pid in ([own, *children_of(own)] if self._with_children else [own])]
            self.samples.append((time.time(), sum(held)))
            if self._ended.wait(INTERVAL_OF_CHILDREN if self._with_children else INTERVAL):
                return


def resident_of(pid: str) -> int:
    """Return the resident bytes of a process; 0 if it has ended."""
    try:
        return int(Path("/proc", pid, "statm").read_text(encoding="ascii").split()[1]) * PAGE
    except (OSError, IndexError):
        return 0


def children_of(parent: str) -> list[str]:
    """Return the running children of a process."""
    return [pid for pid in os.listdir("/proc") if pid.isdigit() and _parent_of(pid) == parent]


def _parent_of(pid: str) -> str | None:
    try:
        text = Path("/proc", pid, "stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    return text.rpartition(")")[2].split()[1]


def most_of_this_process() -> int:
    """Return the peak bytes of this process.

    `getrusage` is wrong here: a process that a large one started reports the large one's peak.
    """
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
