"""Several transfers at once, in threads that hold up nobody who interrupts the program."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from queue import Empty, SimpleQueue
from typing import TypeVar

T = TypeVar("T")


def transfer_in_threads(action: Callable[[T], object], items: Iterable[T], threads: int) -> Iterator[T]:
    """Call action for each item, in so many threads; gives the items as they are done.

    After an error nothing more is begun, what has begun is waited for, and the first error is raised. Ctrl-C waits for nothing: a
    transfer over a dead line may take minutes to notice, and a thread pool of the standard library would wait for it even at exit.
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
