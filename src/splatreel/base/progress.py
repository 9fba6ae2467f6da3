"""Progress reports: a small protocol, and what its displays share."""

from __future__ import annotations

import threading
import time
import unicodedata
from collections.abc import Callable, Sequence
from itertools import accumulate, pairwise
from typing import Protocol

from splatreel.base.errors import CancelledError

Span = tuple[float, float]
PHRASES = {
    "psnr": "{:.1f} dB",
    "loss": "training error {:.3f}",
    "points": "{:,} points",
    "moving": "{:,} moving points",
    "static": "{:,} static points",
    "lit": "{:,} static points in changing light",
    "appeared": "{:,} of them new",
    "published": "{:,} groups in the reel",
}
"""Display format of each reported number, in words for users."""
ENOUGH_SHARE, ENOUGH_SECONDS = 0.05, 60.0
"""Share of a whole job, or seconds, after which its first steps tell how long the others take. While kernels compile, they do not."""


LISTED = 6
"""Number of names that a sentence lists."""


def printable(text: str) -> str:
    """Return untrusted text with control characters escaped.

    Escapes include the marks that reverse the order of letters, so that the text reads as it is.
    """
    return "".join(
        c if c in "\n\t" or c.isprintable() or unicodedata.category(c) == "Zs" else _escaped(c) for c in text
    )


def listed(texts: Sequence[str]) -> str:
    """Return the first `LISTED` texts, and how many more there are."""
    return ", ".join(texts[:LISTED]) + (f" and {len(texts) - LISTED} more" if len(texts) > LISTED else "")


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


class Progress(Protocol):
    """Reports of a long-running function. No method returns a value, so that any display fits."""

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage.

        Args:
            name: Text shown to the user.
            total: Number of steps.
            span: Part of the whole job, such as (0.2, 0.7), or None if unknown.
        """
        ...

    def update(self, done: int, **numbers: float) -> None:
        """Report the number of finished steps of the current stage, and numbers such as psnr=29.1 or points=40_000."""
        ...

    def note(self, text: str) -> None:
        """Show one line that stays on the screen."""
        ...


class PassedOn:
    """Progress display that passes all reports on. Subclasses change some of them.

    Args:
        progress: Display to pass reports on to.
    """

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Pass the start of a stage on."""
        self._progress.stage(name, total, span)

    def update(self, done: int, **numbers: float) -> None:
        """Pass finished steps on."""
        self._progress.update(done, **numbers)

    def note(self, text: str) -> None:
        """Pass one line on."""
        self._progress.note(text)


class Cancellable(PassedOn):
    """Progress display that raises `CancelledError` at the next report after an event is set."""

    def __init__(self, progress: Progress, cancel: threading.Event) -> None:
        super().__init__(progress)
        self._cancel = cancel

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage."""
        self._check()
        super().stage(name, total, span)

    def update(self, done: int, **numbers: float) -> None:
        """Report finished steps."""
        self._check()
        super().update(done, **numbers)

    def _check(self) -> None:
        if self._cancel.is_set():
            raise CancelledError("Cancelled. Finished parts are kept; the same call continues.")


class Silent:
    """Progress display that shows nothing."""

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Show nothing."""

    def update(self, done: int, **numbers: float) -> None:
        """Show nothing."""

    def note(self, text: str) -> None:
        """Show nothing."""


class PartOf(PassedOn):
    """Progress of one part of a job, which begins and ends at shares 0..1 of it. Spans are mapped into the whole job."""

    def __init__(self, progress: Progress, begin: float, end: float) -> None:
        super().__init__(progress)
        self._begin = begin
        self._end = end

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage."""
        if span is not None:
            scale = self._end - self._begin
            span = self._begin + scale * span[0], self._begin + scale * span[1]
        super().stage(name, total, span)


def parts_of(progress: Progress, costs: Sequence[float]) -> list[PartOf]:
    """Split a job into consecutive parts, in proportion to their costs."""
    whole = sum(costs)
    return [PartOf(progress, begin / whole, end / whole) for begin, end in pairwise([0.0, *accumulate(costs)])]


class Estimate:
    """Estimate of the seconds left, for the whole job if its stages name their spans, else for the stage."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._first: float | None = None  # share of the job that was finished before this process started
        self._job_seconds = 0.0  # of earlier stages that have a span
        self.total = 0
        self.done = 0
        self.span: Span | None = None
        self._stage_start = clock()

    def stage(self, total: int, span: Span | None) -> None:
        """Start a stage."""
        if self.span is not None:
            self._job_seconds += self.stage_seconds
        self.total = total
        self.done = 0
        self.span = span
        self._stage_start = self._clock()
        if span is not None and self._first is None:
            self._first = span[0]

    @property
    def stage_seconds(self) -> float:
        """Seconds since the start of the stage."""
        return self._clock() - self._stage_start

    @property
    def share(self) -> float:
        """Finished share of the stage, 0..1."""
        return min(self.done / self.total, 1.0) if self.total > 0 else 0.0

    def left_in_words(self) -> str:
        """Describe the seconds left, empty if they are unknown or few. "in all" marks an estimate for the whole job."""
        left = self.seconds_left()
        if left is None or left < 0.5:
            return ""
        return f"about {format_seconds(left)} left{'' if self.span is None else ' in all'}"

    def seconds_left(self) -> float | None:
        """Return the estimated seconds left, or None while too little is finished."""
        if self.span is not None and self._first is not None:
            now = self.span[0] + self.share * (self.span[1] - self.span[0])
            done, seconds = now - self._first, self._job_seconds + self.stage_seconds
            enough = done >= ENOUGH_SHARE * (1 - self._first) or (done > 0 and seconds >= ENOUGH_SECONDS)
            return seconds * (1 - now) / done if enough else None
        return self.stage_seconds * (1 - self.share) / self.share if self.share > 0 else None


def join_texts(*texts: str) -> str:
    """Join the texts that are not empty by commas."""
    return ", ".join(filter(None, texts))


def format_seconds(seconds: float) -> str:
    """Format a duration, for example 0.4 s, 12 s, 3 min 05 s or 2 h 10 min."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes == 0:
        return f"{rest} s"
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def format_rounded(seconds: float) -> str:
    """Format a duration that is an estimate: rounded to minutes if it takes minutes, for example 12 s or 3 min."""
    return format_seconds(seconds if seconds < 60 else 60 * round(seconds / 60)).replace(" 00 s", "")


def format_numbers(numbers: dict[str, float]) -> str:
    """Format numbers of a report, for example `29.1 dB, 40,000 points`."""
    other = {name: "{:,} " + name if isinstance(value, int) else name + " {:.4g}" for name, value in numbers.items()}
    return ", ".join(PHRASES.get(name, other[name]).format(value) for name, value in numbers.items())
