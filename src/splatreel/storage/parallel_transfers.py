"""Parallel transfers in daemon threads, which do not delay an interrupt."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from queue import Empty, SimpleQueue
from typing import TypeVar

T = TypeVar("T")


def transfer_in_threads(action: Callable[[T], object], items: Iterable[T], threads: int) -> Iterator[T]:
    """Call `action` for each item in a number of threads and yield finished items.

    After an error no further item is started. The first error is raised when all started items have ended. Ctrl-C does
    not wait for transfers: a transfer over a dead connection may take minutes to fail. A standard thread pool would
    wait for it even at exit.
    """
    waiting: SimpleQueue[T] = SimpleQueue()
    for item in items:
        waiting.put(item)
    done: SimpleQueue[tuple[T, BaseException | None] | None] = SimpleQueue()
    stopped = threading.Event()

    def work() -> None:
        while not stopped.is_set():
            try:
                item = waiting.get_nowait()
            except Empty:
                break
            try:
                action(item)
            except BaseException as error:
                stopped.set()
                done.put((item, error))
            else:
                done.put((item, None))
        done.put(None)

    workers = [threading.Thread(target=work, daemon=True) for _ in range(min(threads, waiting.qsize()))]
    for worker in workers:
        worker.start()
    left, failure = len(workers), None
    try:
        while left:
            result = done.get()
            if result is None:
                left -= 1
            elif result[1] is not None:
                failure = failure or result[1]
            else:
                yield result[0]
    finally:
        stopped.set()
    if failure is not None:
        raise failure
