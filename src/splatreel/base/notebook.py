"""Progress bars in notebooks: Jupyter, Colab, and editors that run IPython's kernel."""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable
from html import escape
from typing import Any

from splatreel.base.progress import Estimate, Span, format_numbers, format_seconds, printable

_PAUSE = 0.2
"""Smallest number of seconds between two drawings of a bar."""


def in_notebook() -> bool:
    """Return True if this process is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return getattr(shell, "kernel", None) is not None


class NotebookBars:
    """Progress display for a notebook: one bar per stage, in the output of the cell."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._display: Callable[..., Any] = importlib.import_module("IPython.display").display
        self._clock = clock
        self._drawn = 0.0
        self._estimate = Estimate(clock)
        self._name = ""
        self._numbers = ""
        self._bar: Any = None

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage."""
        self.close()
        self._estimate.stage(total, span)
        self._name = name
        self._numbers = ""
        self._drawn = self._clock()
        self._bar = self._display(self._bundle(), raw=True, display_id=True)

    def update(self, done: int, **numbers: float) -> None:
        """Report finished steps."""
        self._estimate.done, self._numbers = done, format_numbers(numbers)
        if done >= self._estimate.total or self._clock() - self._drawn >= _PAUSE:
            self._draw()

    def note(self, text: str) -> None:
        """Show one line that stays."""
        self._display({"text/plain": printable(text)}, raw=True)

    def close(self) -> None:
        """Draw the last state of the current bar."""
        if self._bar is not None:
            self._draw()

    def _draw(self) -> None:
        self._drawn = self._clock()
        self._bar.update(self._bundle(), raw=True)

    def _bundle(self) -> dict[str, str]:
        """Return the bar as HTML and as text, by MIME type."""
        estimate = self._estimate
        seconds, left = format_seconds(estimate.stage_seconds), estimate.seconds_left()
        finished = estimate.done >= estimate.total
        parts = [f"done in {seconds}" if finished else f"{100 * estimate.share:.0f} %", self._numbers]
        if not finished and left is not None and left >= 0.5:
            parts.append(estimate.in_words(left))
        text = ", ".join(part for part in parts if part)
        bar = f'<progress max="1" value="{estimate.share:.3f}"></progress>'
        html = f"<div>{escape(printable(self._name))} {bar} {escape(text)}</div>"
        return {"text/html": html, "text/plain": f"{printable(self._name)}: {text}"}
