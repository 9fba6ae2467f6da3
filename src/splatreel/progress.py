"""How long work reports where it is: a small protocol, a display for a terminal and one for a log file."""

from __future__ import annotations

import sys
import time
import unicodedata
from collections.abc import Callable
from typing import Any, Protocol, TextIO

Span = tuple[float, float]


def printable(text: str) -> str:
    """Text that is not ours as a terminal may have it: what is no character, space or new line is escaped.

    So are the marks that turn the order of letters round: what one reads is what there is.
    """
    return "".join(
        c if c in "\n\t" or c.isprintable() or unicodedata.category(c) == "Zs" else _escaped(c) for c in text
    )


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


class Progress(Protocol):
    """What a long function calls; it never asks back, so any display (or none) fits."""

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage of total steps. span: the part of the whole job it is, such as (0.2, 0.7), if known."""
        ...

    def update(self, done: int, **numbers: float) -> None:
        """Steps of the current stage done so far, with numbers worth showing, such as psnr=29.1, points=40_000."""
        ...

    def note(self, text: str) -> None:
        """One line worth keeping."""
        ...


class Silent:
    """Shows nothing."""

    def stage(self, name: str, total: int, span: Span | None = None) -> None: ...

    def update(self, done: int, **numbers: float) -> None: ...

    def note(self, text: str) -> None: ...


class Estimate:
    """Seconds left, of the whole job when its stages say which part of it they are, else of the stage."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._job_start: tuple[float, float] | None = None  # when, and which share of the job was already done
        self._begin_stage(0, None)

    def _begin_stage(self, total: int, span: Span | None) -> None:
        self.total, self.done, self.span = total, 0, span
        self._stage_start = self._clock()

    def stage(self, total: int, span: Span | None) -> None:
        self._begin_stage(total, span)
        if span is not None and self._job_start is None:
            self._job_start = (self._stage_start, span[0])

    @property
    def stage_seconds(self) -> float:
        return self._clock() - self._stage_start

    @property
    def share(self) -> float:
        """Share of the stage that is done, 0..1."""
        return min(self.done / self.total, 1.0) if self.total > 0 else 0.0

    def seconds_left(self) -> float | None:
        """None as long as there is nothing to judge by."""
        if self.span is not None and self._job_start is not None:
            began, first = self._job_start
            now = self.span[0] + self.share * (self.span[1] - self.span[0])
            return (self._clock() - began) * (1 - now) / (now - first) if now > first else None
        return self.stage_seconds * (1 - self.share) / self.share if self.share > 0 else None


class Lines:
    """For a log file or a pipe: a line when a stage starts, about every `interval` seconds, and when it ends."""

    def __init__(
        self, stream: TextIO | None = None, interval: float = 10.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._stream = stream or sys.stderr
        self._interval = interval
        self._clock = clock
        self._estimate = Estimate(clock)
        self._name, self._ended = "", False
        self._last = clock()

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        self._name, self._ended = name, False
        self._estimate.stage(total, span)
        self._last = self._clock()
        self._print(f"{name}: {total} steps")

    def update(self, done: int, **numbers: float) -> None:
        finished = done >= self._estimate.total
        if finished and self._ended:
            return
        self._estimate.done, self._ended = done, finished
        if not finished and self._clock() - self._last < self._interval:
            return
        self._last = self._clock()
        parts = [f"{self._name}: {done}/{self._estimate.total}", format_numbers(numbers)]
        left = self._estimate.seconds_left()
        if finished:
            parts.append(f"took {format_seconds(self._estimate.stage_seconds)}")
        if left is not None and left >= 0.5:
            parts.append(f"{format_seconds(left)} left")
        self._print(", ".join(p for p in parts if p))

    def note(self, text: str) -> None:
        self._print(text)

    def close(self) -> None:
        self._stream.flush()

    def _print(self, text: str) -> None:
        print(printable(text), file=self._stream, flush=True)


class Terminal:
    """For a terminal: one live bar a stage, which stays on the screen when the stage is done."""

    def __init__(self, stream: TextIO | None = None) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn
        from rich.progress import Progress as Bars

        columns: list[Any] = [TextColumn("{task.description:<28}"), BarColumn(bar_width=24)]
        columns += [TextColumn("{task.completed:.0f}/{task.total:.0f}"), TextColumn("{task.fields[text]}")]
        self._bars = Bars(*columns, console=Console(file=stream or sys.stderr))
        self._task: Any = None
        self._estimate = Estimate()

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        if self._task is None:
            self._bars.start()
        self._estimate.stage(total, span)
        self._task = self._bars.add_task(name, total=total, text="")

    def update(self, done: int, **numbers: float) -> None:
        self._estimate.done = done
        left = self._estimate.seconds_left()
        time_text = "" if left is None or left < 0.5 else f"{format_seconds(left)} left"
        if done >= self._estimate.total:
            time_text = format_seconds(self._estimate.stage_seconds)
        text = "  ".join(p for p in (format_numbers(numbers), time_text) if p)
        self._bars.update(self._task, completed=done, text=text)

    def note(self, text: str) -> None:
        self._bars.console.print(printable(text), markup=False, highlight=False)

    def close(self) -> None:
        self._bars.stop()


def console(stream: TextIO | None = None) -> Lines | Terminal:
    """The display that fits stream (standard error if None): live bars at a terminal, lines otherwise."""
    target = sys.stderr if stream is None else stream
    return Terminal(target) if target.isatty() else Lines(target)


def format_seconds(seconds: float) -> str:
    """Such as 0.4 s, 12 s, 3 min 05 s, 2 h 10 min."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes == 0:
        return f"{rest} s"
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def format_numbers(numbers: dict[str, float]) -> str:
    """Such as `psnr 29.13, points 40,000`."""
    return ", ".join(f"{k} {v:,}" if isinstance(v, int) else f"{k} {v:.4g}" for k, v in numbers.items())
