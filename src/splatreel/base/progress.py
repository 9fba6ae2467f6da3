"""Progress reports: a small protocol, a display for terminals and one for log files."""

from __future__ import annotations

import sys
import threading
import time
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, Protocol, TextIO

from splatreel.base.errors import CancelledError

if TYPE_CHECKING:
    from splatreel.base.notebook import NotebookBars

Span = tuple[float, float]
PHRASES = {
    "psnr": "{:.1f} dB",
    "loss": "training error {:.3f}",
    "points": "{:,} points",
    "moving": "{:,} moving points",
    "resting": "{:,} resting points",
    "lit": "{:,} resting points in changing light",
    "appeared": "{:,} of them new",
    "published": "{:,} groups in the reel",
}
"""Display format of each reported number, in words for users."""


def printable(text: str) -> str:
    """Return untrusted text with control characters escaped.

    Escapes include the marks that reverse the order of letters, so that the text reads as it is.
    """
    return "".join(
        c if c in "\n\t" or c.isprintable() or unicodedata.category(c) == "Zs" else _escaped(c) for c in text
    )


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


class Cancellable:
    """Progress display that raises `CancelledError` at the next report after an event is set.

    Args:
        progress: Display to pass reports on to.
        cancel: The event.
    """

    def __init__(self, progress: Progress, cancel: threading.Event) -> None:
        self._progress, self._cancel = progress, cancel

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage."""
        self._check()
        self._progress.stage(name, total, span)

    def update(self, done: int, **numbers: float) -> None:
        """Report finished steps."""
        self._check()
        self._progress.update(done, **numbers)

    def note(self, text: str) -> None:
        """Show one line."""
        self._progress.note(text)

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


class PartOf:
    """Progress of one part of a job, with its spans mapped into the whole job.

    Args:
        progress: Display of the whole job.
        begin: Start of the part within the job, 0..1.
        end: End of the part within the job, 0..1.
    """

    def __init__(self, progress: Progress, begin: float, end: float) -> None:
        self._progress, self._begin, self._end = progress, begin, end

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage."""
        if span is not None:
            scale = self._end - self._begin
            span = self._begin + scale * span[0], self._begin + scale * span[1]
        self._progress.stage(name, total, span)

    def update(self, done: int, **numbers: float) -> None:
        """Report finished steps."""
        self._progress.update(done, **numbers)

    def note(self, text: str) -> None:
        """Show one line."""
        self._progress.note(text)


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
        self.total, self.done = 0, 0
        self.span: Span | None = None
        self._stage_start = clock()

    def stage(self, total: int, span: Span | None) -> None:
        """Start a stage."""
        if self.span is not None:
            self._job_seconds += self.stage_seconds
        self.total, self.done, self.span = total, 0, span
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

    def in_words(self, left: float) -> str:
        """Describe the seconds left. "in all" marks an estimate for the whole job."""
        return f"about {format_seconds(left)} left{'' if self.span is None else ' in all'}"

    def seconds_left(self) -> float | None:
        """Return the estimated seconds left, or None before the first finished step."""
        if self.span is not None and self._first is not None:
            now = self.span[0] + self.share * (self.span[1] - self.span[0])
            done = now - self._first
            return (self._job_seconds + self.stage_seconds) * (1 - now) / done if done > 0 else None
        return self.stage_seconds * (1 - self.share) / self.share if self.share > 0 else None


class Lines:
    """Progress display for a log file or a pipe: one line per stage, printed when the stage ends.

    A stage that takes longer than `interval` also prints a line every `interval` seconds, since many services end jobs that
    print nothing. Call `close` at the end.
    """

    def __init__(
        self, stream: TextIO | None = None, interval: float = 120.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._stream = stream or sys.stderr
        self._interval = interval
        self._clock = clock
        self._estimate = Estimate(clock)
        self._name, self._ended = "", True
        self._numbers: dict[str, float] = {}
        self._last = clock()
        self._lock, self._closed = threading.RLock(), threading.Event()
        self._watch: threading.Thread | None = None

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage. A stage before it that has not reported its end has ended now."""
        with self._lock:
            self._end()
            self._name, self._ended, self._numbers = name, False, {}
            self._estimate.stage(total, span)
            self._last = self._clock()
        if self._watch is None:
            self._watch = threading.Thread(target=self._beat_until_closed, daemon=True)
            self._watch.start()

    def update(self, done: int, **numbers: float) -> None:
        """Report finished steps."""
        with self._lock:
            self._estimate.done = done
            self._numbers = numbers or self._numbers
            if done >= self._estimate.total:
                self._end()

    def note(self, text: str) -> None:
        """Show one line."""
        with self._lock:
            self._last = self._clock()
            self._print(text)

    def close(self) -> None:
        """End the display."""
        self._closed.set()
        with self._lock:
            self._stream.flush()

    def beat(self) -> None:
        """Print the state of the stage, if nothing was printed for `interval` seconds."""
        with self._lock:
            if self._closed.is_set() or self._clock() - self._last < self._interval:
                return
            since = format_seconds(self._estimate.stage_seconds)
            state = "done, continuing" if self._ended else f"{100 * self._estimate.share:.0f} %"
            self._report(f"{state}, {since} so far")

    def _end(self) -> None:
        if not self._ended:
            self._ended = True
            self._report(f"done in {format_seconds(self._estimate.stage_seconds)}")

    def _report(self, state: str) -> None:
        """Print the state of the stage, its last numbers and the time left. The stage itself has no time left when it has ended."""
        self._last = self._clock()
        left = None if self._ended and self._estimate.span is None else self._estimate.seconds_left()
        time_text = "" if left is None or left < 0.5 else self._estimate.in_words(left)
        parts = [f"{self._name}: {state}", format_numbers(self._numbers), time_text]
        self._print(", ".join(p for p in parts if p))

    def _beat_until_closed(self) -> None:
        while not self._closed.wait(self._interval / 4):
            try:
                self.beat()
            except (OSError, ValueError):  # the reader of the stream has ended
                return

    def _print(self, text: str) -> None:
        print(printable(text), file=self._stream, flush=True)


def _bars(stream: TextIO) -> Any:
    """Return a live display with two lines per stage: progress and elapsed time, then results and time left.

    One line would not fit into a terminal of 80 columns.
    """
    from rich.console import Console, RenderableType
    from rich.padding import Padding
    from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn
    from rich.text import Text

    class Elapsed(ProgressColumn):
        """Elapsed time of a stage, in words that cannot be read as the time left."""

        def render(self, task: Task) -> Text:
            text = format_seconds((task.finished_time if task.finished else task.elapsed) or 0.0)
            return Text(f"done in {text}" if task.finished else f"{text} so far")

    class Bars(Progress):
        def get_renderables(self) -> Iterable[RenderableType]:
            for task in self.tasks:
                yield self.make_tasks_table([task])
                if task.fields["text"]:
                    yield Padding(Text(task.fields["text"]), (0, 0, 0, 4))

        def settle(self) -> None:
            """Print finished stages permanently: the live part must fit on the screen."""
            settled = list(self.get_renderables())
            for task in self.tasks:
                self.remove_task(task.id)
            for each in settled:
                self.console.print(each)

    columns = [SpinnerColumn(finished_text=" "), TextColumn("{task.description:<47}", markup=False)]
    columns += [BarColumn(bar_width=8), TextColumn("{task.percentage:>3.0f} %"), Elapsed()]
    return Bars(*columns, console=Console(file=stream))


class Terminal:
    """Progress display for a terminal: one live bar per stage. The bar stays on the screen when its stage ends."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._bars = _bars(stream or sys.stderr)
        self._task: Any = None
        self._estimate = Estimate()

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage."""
        if self._task is None:
            self._bars.start()
        self._bars.settle()
        self._estimate.stage(total, span)
        self._task = self._bars.add_task(name, total=total, text="")

    def update(self, done: int, **numbers: float) -> None:
        """Report finished steps."""
        self._estimate.done = done
        left = self._estimate.seconds_left() if done < self._estimate.total else None
        time_text = "" if left is None or left < 0.5 else self._estimate.in_words(left)
        text = ", ".join(p for p in (format_numbers(numbers), time_text) if p)
        self._bars.update(self._task, completed=done, text=text)

    def note(self, text: str) -> None:
        """Show one line."""
        self._bars.console.print(printable(text), markup=False, highlight=False)

    def close(self) -> None:
        """End the display."""
        self._bars.stop()


def console(stream: TextIO | None = None) -> Lines | Terminal | NotebookBars:
    """Return the display for a stream: live bars for a terminal or a notebook, lines otherwise.

    Args:
        stream: Output; None is standard error.
    """
    from splatreel.base.notebook import NotebookBars, in_notebook

    if stream is None and in_notebook():
        return NotebookBars()
    target = sys.stderr if stream is None else stream
    return Terminal(target) if target.isatty() else Lines(target)


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
