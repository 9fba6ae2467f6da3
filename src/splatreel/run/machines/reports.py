"""Progress messages from a worker to the driver."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from splatreel.base.errors import SplatreelError
from splatreel.base.process import peak_memory_bytes
from splatreel.base.progress import Span

INTERVAL = 0.5
"""Smallest number of seconds between two reports of progress."""


@dataclass(frozen=True)
class Started:
    """A node starts a chapter, or continues one that another node lost."""

    chapter: int
    node: str


@dataclass(frozen=True)
class Reached:
    """Progress of a chapter.

    Attributes:
        share: Share of the chapter that is done, 0..1.
        memory: Largest number of bytes that the process held; None if unknown.
    """

    chapter: int
    share: float
    memory: int | None


@dataclass(frozen=True)
class Noted:
    """A note of a chapter, to be shown once."""

    chapter: int
    text: str


@dataclass(frozen=True)
class GroupDone:
    """A finished group."""

    chapter: int
    group: int


@dataclass(frozen=True)
class ChapterEnded:
    """The end of a chapter."""

    chapter: int
    error: str | None = None


Report = Started | Reached | Noted | GroupDone | ChapterEnded


class Reporter:
    """Progress of a chapter that is sent on as reports.

    Args:
        chapter: Index of the chapter.
        send: Called with each report. It must not raise.
        clock: Clock in seconds.
    """

    def __init__(
        self, chapter: int, send: Callable[[Report], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._chapter = chapter
        self._send = send
        self._clock = clock
        self._total = 1
        self._span = (0.0, 0.0)
        self._last = clock() - INTERVAL

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Begin a stage."""
        self._total = max(total, 1)
        self._span = span or (self._span[1], self._span[1])
        self._reached(0.0)

    def update(self, done: int, **numbers: float) -> None:
        """Report steps of the stage."""
        self._reached(min(done / self._total, 1.0))

    def note(self, text: str) -> None:
        """Report a note."""
        self._send(Noted(self._chapter, text))

    def _reached(self, share: float) -> None:
        if self._clock() - self._last < INTERVAL:
            return
        self._last = self._clock()
        begin, end = self._span
        self._send(Reached(self._chapter, begin + share * (end - begin), peak_memory_bytes()))


def describe_error(error: Exception) -> str:
    """Return the error of another process as a sentence. An unexpected error also names its place."""
    text = " ".join(str(error).split())
    if isinstance(error, SplatreelError):
        return text
    frames = traceback.extract_tb(error.__traceback__)
    where = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return f"{type(error).__name__}{where}: {text or 'no message'}"
