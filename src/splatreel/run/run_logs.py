"""Logs of a run in OUT/work/logs: PART.log of each job, for people, and history*.jsonl with stages, numbers and notes, for reports."""

from __future__ import annotations

import json
import os
import re
import socket
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from splatreel import __version__
from splatreel.base import threads
from splatreel.base.errors import SplatreelError
from splatreel.base.process import peak_memory_bytes, steady_clock
from splatreel.base.progress import PassedOn, Progress, Span
from splatreel.base.untrusted import is_number, read_file
from splatreel.run.machine_speed import describe_processor

LOGS = "logs"
_STARTED = re.compile(r"\S+ attempt (\d+) on (\S+),")
_ENDED = re.compile(r"\S+ (finished|failed)\b(?:.*?: (.*))?")


def log_file(work: Path, part: str) -> Path:
    """Return the path of the log of a job, such as chapter0003."""
    return work / LOGS / f"{part}.log"


class JobLog:
    """Appends lines to the log of a job. Errors of the disk are ignored."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def write(self, text: str) -> None:
        """Append a line, with the time in UTC."""
        now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        with suppress(OSError), open(self.path, "a", encoding="utf-8") as file:
            file.write(f"{now} {text}\n")


class LoggedProgress(PassedOn):
    """Progress display of a job that also logs stages and notes."""

    def __init__(self, progress: Progress, log: JobLog) -> None:
        super().__init__(progress)
        self._log = log

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Log and show the beginning of a stage."""
        self._log.write(name)
        super().stage(name, total, span)

    def note(self, text: str) -> None:
        """Log and show a note."""
        self._log.write(f"note: {text}")
        super().note(text)


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


SAMPLES = 40
"""Maximum number of samples per stage."""
LARGEST = 256 << 20
"""Largest size of a history that is read, in bytes."""
_GROUP = re.compile(r"group (\d+)(?:/\d+)?: (.*)", re.S)


class RecordedProgress(PassedOn):
    """Progress display of a job that also records its history. Errors of the disk are ignored.

    Args:
        progress: Display.
        work: Folder OUT/work.
        part: Name of the job; empty for a run of one job.
        device: Device that trains.
        clock: Seconds since 1970; by default those of `steady_clock`.
    """

    def __init__(
        self, progress: Progress, work: Path, part: str, device: str, clock: Callable[[], float] | None = None
    ) -> None:
        super().__init__(progress)
        self._clock = clock or steady_clock()
        self._device = device
        self._path = work / LOGS / f"history{part and f'-{part}'}.jsonl"
        self._total = 0
        self._next = 0
        self._begun = False

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Record and show the beginning of a stage."""
        self._total = total
        self._next = 0
        self._write({"stage": name, "total": total})
        super().stage(name, total, span)

    def update(self, done: int, **numbers: float) -> None:
        """Show steps, and record some of them."""
        if done >= self._next or done >= self._total:
            self._next = done + max(self._total // SAMPLES, 1)
            self._write({"done": done, **numbers})
        super().update(done, **numbers)

    def note(self, text: str) -> None:
        """Record and show a note."""
        self._write({"note": text})
        super().note(text)

    def _write(self, line: dict[str, Any]) -> None:
        with suppress(OSError, ValueError):  # ValueError: a loss that is no longer finite
            if not self._begun:
                self._begun = True
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._write({"machine": describe_processor(), "device": self._device, "version": __version__})
            text = json.dumps({"at": round(self._clock(), 1), **line}, allow_nan=False)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(text + "\n")


@dataclass
class RecordedStage:
    """A stage of a run.

    Attributes:
        name: Text of the stage without its group.
        group: Number of the group, counted from 0; None outside of groups.
        total: Number of steps.
        begin: Time of its beginning, seconds since 1970.
        end: Time of the last record.
        samples: Steps done and numbers, such as {"loss": 0.02, "points": 4000}.
    """

    name: str
    group: int | None
    total: int
    begin: float
    end: float
    samples: list[tuple[int, dict[str, float]]] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Seconds that the stage took so far; 0 if the clock was set back meanwhile."""
        return max(self.end - self.begin, 0.0)

    def curve(self, name: str) -> list[tuple[float, float]]:
        """Return (share of the stage, value) of a number such as loss."""
        return [(done / max(self.total, 1), numbers[name]) for done, numbers in self.samples if name in numbers]


@dataclass
class RunHistory:
    """History of all jobs of a run.

    Attributes:
        stages: Stages in the order of their beginning. A stage that was interrupted and repeated appears twice.
        notes: Notes without repetitions, with the number of their group, counted from 1.
        machines: Descriptions of the machines that worked, without repetitions.
    """

    stages: list[RecordedStage] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    machines: list[str] = field(default_factory=list)

    def group_seconds(self) -> dict[int, float]:
        """Return the seconds spent on each group."""
        found: dict[int, float] = {}
        for stage in self.stages:
            if stage.group is not None:
                found[stage.group] = found.get(stage.group, 0.0) + stage.seconds
        return found


def read_history(work: Path) -> RunHistory:
    """Return the history in OUT/work; empty if there is none. Lines that a killed run left unfinished are skipped."""
    history = RunHistory()
    for path in sorted((work / LOGS).glob("history*.jsonl")):
        try:
            lines = read_file(path, LARGEST, SplatreelError).splitlines()
        except SplatreelError:
            continue
        _read_lines(lines, history)
    history.stages.sort(key=lambda stage: stage.begin)
    return history


def _read_lines(lines: list[bytes], history: RunHistory) -> None:
    """Add the lines of one job to a history."""
    stage: RecordedStage | None = None
    for text in lines:
        try:
            line = json.loads(text)
        except (ValueError, RecursionError):
            continue
        if not isinstance(line, dict) or not is_number(line.get("at")):
            continue
        at, total = float(line["at"]), line.get("total")
        if "machine" in line:
            described = f"{line['machine']}, {line.get('device')}, Splatreel {line.get('version')}"
            history.machines += [described] if described not in history.machines else []
            stage = None  # a process that was killed left the stage before
        elif "note" in line:
            group = None if stage is None else stage.group
            note = str(line["note"]) if group is None else f"Group {group + 1}: {line['note']}"
            history.notes += [note] if note not in history.notes else []
        elif "stage" in line:
            if stage is not None:
                stage.end = at
            found = _GROUP.fullmatch(str(line["stage"]))
            group, name = (int(found[1]) - 1, found[2]) if found else (None, str(line["stage"]))
            stage = RecordedStage(name, group, total if isinstance(total, int) else 0, at, at)
            history.stages.append(stage)
        elif stage is not None and is_number(line.get("done")):
            stage.end = at
            numbers = {name: float(v) for name, v in line.items() if name not in ("at", "done") and is_number(v)}
            stage.samples.append((int(line["done"]), numbers))
