"""Displays of progress: live bars in a terminal or a notebook, lines in a log file."""

from __future__ import annotations

import importlib
import sys
import threading
import time
from collections.abc import Callable, Iterable
from html import escape
from typing import Any, Self, TextIO

from splatreel.base.progress import Estimate, Span, format_numbers, format_seconds, join_texts, printable


class Display:
    """Base of the displays, which a `with` block closes."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the display."""


class Lines(Display):
    """Progress display for a log file or a pipe: one line per stage, printed when the stage ends.

    A stage that takes longer than `interval` also prints a line every `interval` seconds, since many services end jobs that
    print nothing.
    """

    def __init__(
        self, stream: TextIO | None = None, interval: float = 120.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._stream = stream or sys.stderr
        self._interval = interval
        self._clock = clock
        self._estimate = Estimate(clock)
        self._name = ""
        self._ended = True
        self._numbers: dict[str, float] = {}
        self._last = clock()
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._watch: threading.Thread | None = None

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage. A stage before it that has not reported its end has ended now."""
        with self._lock:
            self._end()
            self._name = name
            self._ended = False
            self._numbers = {}
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
        left = "" if self._ended and self._estimate.span is None else self._estimate.left_in_words()
        self._print(join_texts(f"{self._name}: {state}", format_numbers(self._numbers), left))

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


class Terminal(Display):
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
        left = self._estimate.left_in_words() if done < self._estimate.total else ""
        self._bars.update(self._task, completed=done, text=join_texts(format_numbers(numbers), left))

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
    if stream is None and in_notebook():
        return NotebookBars()
    target = sys.stderr if stream is None else stream
    return Terminal(target) if target.isatty() else Lines(target)


_PAUSE = 0.2
"""Smallest number of seconds between two drawings of a bar."""


def in_notebook() -> bool:
    """Return True if this process is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return getattr(shell, "kernel", None) is not None


class NotebookBars(Display):
    """Progress display for a notebook: one bar per stage, in the output of the cell."""

    def __init__(self) -> None:
        self._display: Callable[..., Any] = importlib.import_module("IPython.display").display
        self._drawn = 0.0
        self._estimate = Estimate()
        self._name = ""
        self._numbers = ""
        self._bar: Any = None

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage."""
        self.close()
        self._estimate.stage(total, span)
        self._name = name
        self._numbers = ""
        self._drawn = time.monotonic()
        self._bar = self._display(self._bundle(), raw=True, display_id=True)

    def update(self, done: int, **numbers: float) -> None:
        """Report finished steps."""
        self._estimate.done, self._numbers = done, format_numbers(numbers)
        if done >= self._estimate.total or time.monotonic() - self._drawn >= _PAUSE:
            self._draw()

    def note(self, text: str) -> None:
        """Show one line that stays."""
        self._display({"text/plain": printable(text)}, raw=True)

    def close(self) -> None:
        """Draw the last state of the current bar."""
        if self._bar is not None:
            self._draw()

    def _draw(self) -> None:
        self._drawn = time.monotonic()
        self._bar.update(self._bundle(), raw=True)

    def _bundle(self) -> dict[str, str]:
        """Return the bar as HTML and as text, by MIME type."""
        estimate = self._estimate
        if estimate.done >= estimate.total:
            text = join_texts(f"done in {format_seconds(estimate.stage_seconds)}", self._numbers)
        else:
            text = join_texts(f"{100 * estimate.share:.0f} %", self._numbers, estimate.left_in_words())
        bar = f'<progress max="1" value="{estimate.share:.3f}"></progress>'
        html = f"<div>{escape(printable(self._name))} {bar} {escape(text)}</div>"
        return {"text/html": html, "text/plain": f"{printable(self._name)}: {text}"}
