"""Log of one job of a run, OUT/work/logs/PART.log: machine, time, number of attempts, and the reason of a failure."""

from __future__ import annotations

import os
import re
import socket
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from splatreel import __version__
from splatreel.base import threads
from splatreel.base.process import peak_memory_bytes
from splatreel.base.progress import Progress, Span

LOGS = "logs"
_STARTED = re.compile(r"\S+ attempt (\d+) on (\S+),")
_ENDED = re.compile(r"\S+ (finished|failed)\b(?:.*?: (.*))?")


def log_file(work: Path, part: str) -> Path:
    """Return the path of the log of a job, such as chapter0003."""
    return work / LOGS / f"{part}.log"


class JobLog:
    """Appends lines to the log of a job. Errors of the disk are ignored."""

    def __init__(self, path: Path) -> None:
        """Remember the file."""
        self.path = path

    def write(self, text: str) -> None:
        """Append a line, with the time in UTC."""
        now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        with suppress(OSError), open(self.path, "a", encoding="utf-8") as file:
            file.write(f"{now} {text}\n")


class LoggedProgress:
    """Progress display of a job that also logs stages and notes."""

    def __init__(self, progress: Progress, log: JobLog) -> None:
        """Remember the display and the log."""
        self._progress = progress
        self._log = log

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Log and show the beginning of a stage."""
        self._log.write(name)
        self._progress.stage(name, total, span)

    def update(self, done: int, **numbers: float) -> None:
        """Show steps."""
        self._progress.update(done, **numbers)

    def note(self, text: str) -> None:
        """Log and show a note."""
        self._log.write(f"note: {text}")
        self._progress.note(text)


@contextmanager
def logged(work: Path, part: str) -> Iterator[JobLog]:
    """Log one attempt at a job: its beginning, its end, and the traceback of an error."""
    log = JobLog(log_file(work, part))
    with suppress(OSError):
        log.path.parent.mkdir(parents=True, exist_ok=True)
    before, started = read_log(work, part), time.monotonic()
    log.write(
        f"attempt {before.attempts + 1} on {socket.gethostname()}, process {os.getpid()}, {threads.count()} threads, "
        f"Splatreel {__version__}"
    )
    try:
        yield log
    except BaseException as error:
        log.write(
            f"failed after {time.monotonic() - started:.0f} s: {type(error).__name__}: {' '.join(str(error).split())}"
        )
        with suppress(OSError), open(log.path, "a", encoding="utf-8") as file:
            traceback.print_exception(error, file=file)
        raise
    memory = peak_memory_bytes()
    held = f", {memory / 1e9:.1f} GB at most" if memory is not None else ""
    log.write(f"finished after {time.monotonic() - started:.0f} s{held}")


@dataclass(frozen=True)
class LoggedState:
    """State of a job according to its log.

    Attributes:
        state: waiting, running (or lost), finished or failed.
        node: Machine of the last attempt.
        attempts: Number of attempts.
        error: Reason why the last attempt failed, in one line.
    """

    state: str = "waiting"
    node: str | None = None
    attempts: int = 0
    error: str | None = None


def read_log(work: Path, part: str) -> LoggedState:
    """Return the state of a job according to its log. A job without a log is waiting."""
    try:
        lines = log_file(work, part).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return LoggedState()
    found = LoggedState()
    for line in lines:
        if match := _STARTED.match(line):
            found = LoggedState("running", match[2], int(match[1]))
        elif match := _ENDED.match(line):
            found = LoggedState(match[1], found.node, found.attempts, match[2] if match[1] == "failed" else None)
    return found
