"""The number of threads that the program uses, and the thread pool that runs kernels.

Kernels, matrix products, OpenCV and the decoders run one after another, so they share one number.
"""

from __future__ import annotations

import functools
import itertools
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Any, TypeVar

from splatreel.base.errors import UsageError
from splatreel.base.process import cpu_quota

Item = TypeVar("Item")
Result = TypeVar("Result")
VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
"""Environment variables in which libraries find their number of threads when they are loaded."""
_limit: int | None = None
_caller = threading.local()


@functools.cache
def available() -> int:
    """Return the number of processor cores that this process may use, by its affinity and its share of their time.

    The first answer is kept. Reading the limits takes 0.1 ms, as long as a small kernel, and every call of a kernel asks.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = cpu_quota()
    return cores if quota is None else max(1, min(cores, int(quota)))


def count() -> int:
    """Return the number of threads to use: the limit that `use` set, else all cores, and at most those of `at_most`."""
    threads, most = _limit or available(), getattr(_caller, "most", None)
    return threads if most is None else min(threads, most)


@contextmanager
def at_most(number: int) -> Iterator[None]:
    """Use at most a number of threads, at least one, inside a `with` block of the calling thread, while others use the rest."""
    before = getattr(_caller, "most", None)
    _caller.most = max(1, number)
    try:
        yield
    finally:
        _caller.most = before


def chosen() -> int | None:
    """Return the limit that `use` set, or None."""
    return _limit


def use(threads: int | None) -> None:
    """Limit the program to a number of threads.

    Libraries that are loaded later read the limit from their environment variables.

    Args:
        threads: Number of threads, 1 to the number of cores. None: change nothing.

    Raises:
        UsageError: The number is out of range.
    """
    global _limit
    if threads is None:
        return
    cores = available()
    if not 1 <= threads <= cores:
        raise UsageError(
            f"--threads {threads} is out of range: this process has {cores} core{'s'[: cores > 1]}. Choose 1 to {cores}, "
            "or leave it out to use all of them."
        )
    _limit = threads
    for name in VARIABLES:
        os.environ[name] = str(threads)
    for module, setter in (("torch", "set_num_threads"), ("cv2", "setNumThreads")):
        if module in sys.modules:
            getattr(sys.modules[module], setter)(threads)


@contextmanager
def limited(threads: int) -> Iterator[None]:
    """Set the number of threads inside a `with` block, for measurements."""
    global _limit
    before, _limit = _limit, threads
    try:
        yield
    finally:
        _limit = before


def map_parallel(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return the function's results for all items, in order, computed on all threads.

    Kernels that the function calls run in the same thread while there are items for all threads. The last items share the threads.

    Args:
        function: Must release the GIL in its long calls, as OpenCV, FFmpeg and compiled kernels do.
        items: Arguments of the function.

    Raises:
        Exception: An exception that the function raised.
    """
    given, workers = list(items), count()
    found: list[Result] = [None] * len(given)  # type: ignore[list-item]

    def work(first: int, last: int) -> None:
        for place in range(first, last):
            with at_most(workers // min(workers, len(given) - place)):
                found[place] = function(given[place])

    run_ranges(work, len(given), (), chunks=len(given))
    return found


def run_ranges(
    function: Callable[..., Any], items: int, arguments: tuple[Any, ...], grain: int = 1, chunks: int | None = None
) -> None:
    """Call `function(first, last, *arguments)` for consecutive ranges that cover 0..items, on all threads.

    The calling thread works too and takes over the ranges of threads that the system does not schedule in time. The function must
    release the GIL to run in parallel, and its ranges must be independent.

    Args:
        function: Called once for each range.
        items: Number of items.
        arguments: Passed on to every call.
        grain: Smallest number of items in a range, unless there are fewer items.
        chunks: Number of ranges. None: one per thread.

    Raises:
        Exception: The first exception that the function raised.
    """
    workers = count()
    ranges = max(1, min(chunks or workers, items // grain))
    if workers == 1 or ranges == 1:
        if items:
            function(0, items, *arguments)
        return
    cuts = [items * k // ranges for k in range(ranges + 1)]
    _pool.run(function, cuts, arguments, min(workers, ranges) - 1)


class _Job:
    """Ranges that threads claim one after another."""

    def __init__(self, function: Callable[..., Any], cuts: list[int], arguments: tuple[Any, ...]) -> None:
        self.function = function
        self.cuts = cuts
        self.arguments = arguments
        self.places = itertools.count()  # `next` is atomic under the GIL
        self.left = len(cuts) - 1  # ranges that the calling thread did not claim
        self.done: SimpleQueue[BaseException | None] = SimpleQueue()

    def work(self) -> None:
        """Run ranges until none is left to claim."""
        while (place := next(self.places)) < len(self.cuts) - 1:
            self.left -= 1
            self.function(self.cuts[place], self.cuts[place + 1], *self.arguments)

    def help(self) -> None:
        """Run ranges in a thread of the pool, and report the end or the error of each to `done`."""
        while (place := next(self.places)) < len(self.cuts) - 1:
            error = None
            try:
                self.function(self.cuts[place], self.cuts[place + 1], *self.arguments)
            except BaseException as raised:
                error = raised
            self.done.put(error)

    def wait(self) -> list[BaseException]:
        """Wait for the ranges that other threads claimed. Return their errors."""
        errors = []
        while self.left:
            if (error := self.done.get()) is not None:
                errors.append(error)
            self.left -= 1
        return errors

    def stop(self) -> None:
        """Claim all ranges that are left without running them, and wait for those of other threads."""
        while next(self.places) < len(self.cuts) - 1:
            self.left -= 1
        self.wait()

    def forget(self) -> None:
        """Drop the function and its arguments: requests in the queue must not keep them alive."""
        del self.function, self.arguments


_WAITING = 16
"""Requests that may wait in the queue, per thread of the pool."""


class _Pool:
    """Threads that sleep until there is a job."""

    def __init__(self) -> None:
        self.jobs: SimpleQueue[_Job] = SimpleQueue()
        self.size = 0
        self.growing = threading.Lock()

    def run(self, function: Callable[..., Any], cuts: list[int], arguments: tuple[Any, ...], helpers: int) -> None:
        """Run the ranges between cuts in this thread and in up to `helpers` threads of the pool."""
        if self.size < helpers:
            self._grow(helpers)
        job = _Job(function, cuts, arguments)
        # Requests of jobs that are over stay in the queue while all threads are busy or have not woken up. A free thread skips them.
        for _ in range(min(helpers, _WAITING * self.size - self.jobs.qsize())):
            self.jobs.put(job)
        try:
            job.work()
            errors = job.wait()
        except BaseException:
            job.stop()
            raise
        finally:
            job.forget()
        if errors:
            raise errors[0]

    def _grow(self, size: int) -> None:
        with self.growing:
            for number in range(self.size, size):
                threading.Thread(target=self._serve, name=f"splatreel-{number}", daemon=True).start()
            self.size = max(self.size, size)

    def _serve(self) -> None:
        jobs = self.jobs
        while True:
            job = jobs.get()
            job.help()
            del job  # so that a sleeping thread does not keep the job's arguments alive


_pool = _Pool()


def _renew() -> None:
    """Replace the pool in a forked process, because the pool's threads do not survive the fork."""
    global _pool
    _pool = _Pool()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew)
