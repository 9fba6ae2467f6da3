"""A run on this machine alone, by a pool of as many processes as its cores, GPUs and memory suit."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from splatreel.base import threads
from splatreel.base.errors import UsageError
from splatreel.base.process import signals_held
from splatreel.base.progress import Progress, Silent, parts_of
from splatreel.run.device_choice import count_cuda_devices, release_cuda_memory
from splatreel.run.estimate import Division, divide
from splatreel.run.jobs import ChapteredRun, scene_job
from splatreel.run.machines.driver import Driver
from splatreel.run.machines.reports import ChapterEnded, Noted, Reached, Report
from splatreel.run.machines.worker import serve_chapters
from splatreel.run.output.group_writer import PresentationHook, no_presentation
from splatreel.run.pipeline import Result, RunSpec, reconstruct_run, result_of
from splatreel.run.requirements import free_memory, needed_memory

PATIENCE = 2.0
"""Seconds for all workers to end before they are killed. A command must end within five seconds of a signal."""


def reconstruct_here(
    spec: RunSpec,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    present: PresentationHook = no_presentation,
) -> Result:
    """Reconstruct a run like `pipeline.reconstruct`, by several processes where a video has several chapters and that is faster.

    `workers` chapters are made at a time; None chooses a number that suits the machine.

    Raises:
        UsageError: There are fewer cores than workers.
        ReconstructionError: A chapter failed. All other chapters are finished first.
        SplatreelError: As `pipeline.reconstruct` raises it.
    """
    progress = progress or Silent()
    with spec.opened() as run:
        division = division_of(run, workers)
        if division.workers == 1:
            return reconstruct_run(run, progress, present)
        with run.lock():
            scene_job(run, parts_of(progress, run.costs())[0])
            if run.device_name == "cuda":
                release_cuda_memory()  # for the worker that uses the same GPU
            driver = Driver(run, progress, present, division.workers)
            with driver, WorkerPool(spec, places(run, division.workers), division.threads, _need(run)) as pool:
                pool.make(driver.todo, driver.receive)
                driver.finish()
        return result_of(run)


def division_of(run: ChapteredRun, workers: int | None = None) -> Division:
    """Return how the chapters of a run share this machine. `workers` is limited by the chapters; None chooses the fastest division.

    Raises:
        UsageError: There are less than one or more workers than cores.
    """
    cores, chapters = threads.count(), len(run.chapters)
    if workers is not None:
        if not 1 <= workers <= cores:
            raise UsageError(
                f"--workers {workers} is out of range: this process has {cores} core{'s'[: cores > 1]}. Choose 1 to {cores}, or "
                "leave the option out for a number that suits the machine."
            )
        workers = min(workers, chapters)
        return Division(workers, cores // workers)
    if run.device_name == "cuda":
        workers = max(1, min(count_cuda_devices(), chapters, cores))
        return Division(workers, cores // workers)
    if run.gpu is not None:  # one process uses the GPU, and all cores for the rest
        return Division(1, cores)
    free = free_memory()
    return divide(cores, chapters, None if free is None else max(1, free // _need(run)))


def places(run: ChapteredRun, workers: int) -> list[str | None]:
    """Return the GPU of each worker, as CUDA_VISIBLE_DEVICES names it; None for a worker without a GPU."""
    if run.device_name != "cuda":
        return [None] * workers
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = visible.split(",") if visible else [str(index) for index in range(count_cuda_devices())]
    return [names[index % len(names)] for index in range(workers)]


def _need(run: ChapteredRun) -> int:
    return needed_memory(run.capture, run.config)


@dataclass
class Worker:
    """A worker process.

    Attributes:
        gpu: GPU that it uses, if any.
        chapter: Chapter that it makes; None while it is idle.
        memory: Largest number of bytes that it held.
    """

    process: SpawnProcess
    connection: Connection
    gpu: str | None
    chapter: int | None = None
    memory: int = 0


class WorkerPool:
    """Makes chapters in processes of its own. Use as a context manager: leaving it ends all processes.

    A chapter waits until another one is finished if the free memory does not suffice for both.

    Args:
        spec: The run.
        places: For each worker the GPU that it uses, or None.
        threads: Number of threads of each worker.
        need: Approximate bytes of memory of a chapter.
    """

    def __init__(self, spec: RunSpec, places: list[str | None], threads: int, need: int) -> None:
        self._spec = pickle.dumps(spec)
        self._threads = threads
        self._need = need
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

    def make(self, chapters: Iterable[int], receive: Callable[[Report], None]) -> None:
        """Make chapters in order.

        A chapter whose process was killed is tried once more. If memory may have run out, fewer chapters are then made at a time.

        Args:
            chapters: Indices of the chapters.
            receive: Called with each report. The last one of a chapter is `ChapterEnded`.
        """
        self._waiting.extend(chapters)
        while self._waiting or self._busy:
            self._hand_out()
            for connection in wait([worker.connection for worker in self._workers], timeout=1.0):
                worker = next(worker for worker in self._workers if worker.connection is connection)
                if (report := self._report_of(worker)) is not None:
                    receive(report)

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
            except OSError:  # it died while it was idle; its closed connection tells so
                return

    def _fits(self) -> bool:
        """Return True if there is memory for one more chapter, once all running chapters have taken what they need."""
        free, busy = free_memory(), self._busy
        need = max([self._need, *(worker.memory for worker in self._workers)])
        return free is None or free >= need + sum(need - worker.memory for worker in busy)

    def _start(self) -> Worker:
        context = multiprocessing.get_context("spawn")
        mine, theirs = context.Pipe()
        place = self._places.popleft()
        arguments = (self._spec, self._threads, place, theirs)
        process = context.Process(target=serve_chapters, args=arguments, name="splatreel worker", daemon=True)
        with signals_held(signal.SIGINT):
            process.start()
        theirs.close()
        self._workers.append(Worker(process, mine, place))
        return self._workers[-1]

    def _report_of(self, worker: Worker) -> Report | None:
        try:
            report: Report = worker.connection.recv()
        except (EOFError, OSError):
            return self._remove_dead(worker)
        if isinstance(report, Reached):
            worker.memory = report.memory or 0
        if isinstance(report, ChapterEnded):
            worker.chapter = None
        return report

    def _remove_dead(self, worker: Worker) -> Report | None:
        """Remove a dead worker. Its chapter is tried again if the process was killed, and was not killed before."""
        worker.process.join()
        worker.connection.close()
        self._workers.remove(worker)
        self._places.append(worker.gpu)
        chapter, how = worker.chapter, _death_signal(worker.process.exitcode)
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
        beside = f", with {self._most} at a time in case memory ran out" if fewer else ""
        return Noted(chapter, f"its process was ended by {how}; it is tried again{beside}")


def _death_signal(code: int | None) -> str | None:
    """Return the signal that killed a process; None if none did."""
    return None if code is None or code >= 0 else signal.Signals(-code).name
