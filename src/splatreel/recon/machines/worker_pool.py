"""Worker processes on this machine, to which chapters are handed out."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from splatreel.process import interrupts_held
from splatreel.recon.machines.reports import ChapterEnded, Noted, Reached, Report
from splatreel.recon.machines.run_spec import RunSpec
from splatreel.recon.machines.worker import serve
from splatreel.recon.run.memory import free_memory

PATIENCE = 2.0
"""Seconds that workers get to end, all together, before they are killed: a command ends within five of a signal."""


@dataclass
class Worker:
    """chapter: that it makes; None while it waits for one. memory: bytes that it took at most."""

    process: SpawnProcess
    connection: Connection
    gpu: str | None
    chapter: int | None = None
    memory: int = 0


class WorkerPool:
    """Makes chapters in processes of its own. Use as a context manager: at the end none of them is left, whatever happens.

    places: for each worker the GPU that it uses, or None. threads: of each. need: bytes of memory that a chapter takes, about. Where
    the memory that is free would not do for one more, a chapter waits until another is finished.
    """

    def __init__(self, spec: RunSpec, places: list[str | None], threads: int, need: int) -> None:
        self._spec, self._threads, self._need = pickle.dumps(spec), threads, need
        self._places = deque(places)
        self._most = len(places)
        self._workers: list[Worker] = []
        self._tried: set[int] = set()
        self._waiting: deque[int] = deque()

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.process.terminate()
        end = time.monotonic() + PATIENCE
        for worker in self._workers:
            worker.process.join(max(end - time.monotonic(), 0))
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.connection.close()

    def make(self, chapters: Iterable[int], hear: Callable[[Report], None]) -> None:
        """All of these chapters, those first that come first. hear: called with each report; the last of a chapter is `ChapterEnded`.

        A chapter whose process is killed is tried once more, and with fewer beside it where it may be memory that ran out.
        """
        self._waiting.extend(chapters)
        while self._waiting or self._busy:
            self._hand_out()
            for connection in wait([worker.connection for worker in self._workers], timeout=1.0):
                worker = next(worker for worker in self._workers if worker.connection is connection)
                if (report := self._report_of(worker)) is not None:
                    hear(report)

    @property
    def _busy(self) -> list[Worker]:
        return [worker for worker in self._workers if worker.chapter is not None]

    def _hand_out(self) -> None:
        while self._waiting and len(self._busy) < self._most and (not self._busy or self._fits()):
            idle = next((worker for worker in self._workers if worker.chapter is None), None)
            worker = idle or self._start()
            worker.chapter = self._waiting.popleft()
            try:
                worker.connection.send(worker.chapter)
            except OSError:  # it died while it was idle, of which its end of the line tells
                return

    def _fits(self) -> bool:
        """Whether there is memory for one more chapter, once those that are being made have taken what they need."""
        free, busy = free_memory(), self._busy
        need = max([self._need, *(worker.memory for worker in self._workers)])
        return free is None or free >= need + sum(need - worker.memory for worker in busy)

    def _start(self) -> Worker:
        context = multiprocessing.get_context("spawn")
        mine, theirs = context.Pipe()
        place = self._places.popleft()
        arguments = (self._spec, self._threads, place, theirs)
        process = context.Process(target=serve, args=arguments, name="splatreel worker", daemon=True)
        with interrupts_held():
            process.start()
        theirs.close()
        self._workers.append(Worker(process, mine, place))
        return self._workers[-1]

    def _report_of(self, worker: Worker) -> Report | None:
        try:
            report: Report = worker.connection.recv()
        except (EOFError, OSError):
            return self._bury(worker)
        if isinstance(report, Reached):
            worker.memory = report.memory or 0
        if isinstance(report, ChapterEnded):
            worker.chapter = None
        return report

    def _bury(self, worker: Worker) -> Report | None:
        """A worker has died. Its chapter, if it had one, is tried again if that was done to it, and for the first time."""
        worker.process.join()
        worker.connection.close()
        self._workers.remove(worker)
        self._places.append(worker.gpu)
        chapter, how = worker.chapter, _death(worker.process.exitcode)
        if chapter is None:
            return None
        if how is None or chapter in self._tried:
            code = worker.process.exitcode
            return ChapterEnded(
                chapter, f"its process ended {f'by {how}, twice' if how else f'with exit code {code}'}."
            )
        self._tried.add(chapter)
        self._waiting.appendleft(chapter)
        fewer = how == "SIGKILL" and self._most > 1
        self._most -= fewer
        beside = f", with {self._most} at a time in case it was for want of memory" if fewer else ""
        return Noted(chapter, f"its process was ended by {how}; it is tried again{beside}")


def _death(code: int | None) -> str | None:
    """The signal that a process died of."""
    return None if code is None or code >= 0 else signal.Signals(-code).name
