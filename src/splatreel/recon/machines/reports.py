"""What whoever makes a chapter tells whoever shows how far the whole run is."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from splatreel.errors import SplatreelError
from splatreel.process import peak_memory_bytes
from splatreel.progress import Span

INTERVAL = 0.5
"""Seconds between two reports of how far a chapter is, at least."""


@dataclass(frozen=True)
class Started:
    """A node begins a chapter, or goes on with one that another node lost. node: the name of the machine."""

    chapter: int
    node: str


@dataclass(frozen=True)
class Reached:
    """share: of the chapter, 0..1. memory: bytes that the process held at most; None where nobody knows."""

    chapter: int
    share: float
    memory: int | None


@dataclass(frozen=True)
class Noted:
    """A sentence worth keeping."""

    chapter: int
    text: str


@dataclass(frozen=True)
class GroupDone:
    """group: of the whole video."""

    chapter: int
    group: int


@dataclass(frozen=True)
class ChapterEnded:
    """error: one sentence; None where the chapter is finished."""

    chapter: int
    error: str | None = None


Report = Started | Reached | Noted | GroupDone | ChapterEnded


class Reporter:
    """The progress of a chapter, sent on as reports. send: never raises."""

    def __init__(
        self, chapter: int, send: Callable[[Report], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._chapter, self._send, self._clock = chapter, send, clock
        self._total, self._span = 1, (0.0, 0.0)
        self._last = clock() - INTERVAL

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        self._total, self._span = max(total, 1), span or (self._span[1], self._span[1])
        self._reached(0.0)

    def update(self, done: int, **numbers: float) -> None:
        self._reached(min(done / self._total, 1.0))

    def note(self, text: str) -> None:
        self._send(Noted(self._chapter, text))

    def _reached(self, share: float) -> None:
        if self._clock() - self._last < INTERVAL:
            return
        self._last = self._clock()
        begin, end = self._span
        self._send(Reached(self._chapter, begin + share * (end - begin), peak_memory_bytes()))


def in_a_sentence(error: Exception) -> str:
    """What went wrong in another process, for a message of this one; of an error nobody foresaw, also where."""
    text = " ".join(str(error).split())
    if isinstance(error, SplatreelError):
        return text
    frames = traceback.extract_tb(error.__traceback__)
    where = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return f"{type(error).__name__}{where}: {text or 'no more is known'}"
