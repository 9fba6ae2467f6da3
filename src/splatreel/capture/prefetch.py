"""The next group's frames are decoded while the current one trains."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from threading import Event

import numpy as np

from splatreel.capture.base import Capture

CHUNK = 4
"""Frames decoded before a thread looks whether it is still wanted: Ctrl-C does not wait for a whole stretch."""


class FramePrefetcher:
    """Iterates over stretches of a capture, in order, one decoded ahead in a thread.

    stretches: (first, count) frames. Yields uint8 [count, len(cameras), H, W, 3]. At most two stretches are in memory: the one
    in use and the next. Raises where it is iterated what the capture raises. Use as a context manager.
    """

    def __init__(self, capture: Capture, cameras: list[str], stretches: list[tuple[int, int]]) -> None:
        self.capture, self.cameras, self.stretches = capture, cameras, stretches
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="decode")
        self._left = Event()

    def __enter__(self) -> FramePrefetcher:
        return self

    def __exit__(self, *_: object) -> None:
        self._left.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def __iter__(self) -> Iterator[np.ndarray]:
        ahead = self._start(0)
        for index in range(len(self.stretches)):
            assert ahead is not None
            frames = ahead.result()
            ahead = self._start(index + 1)
            yield frames

    def _start(self, index: int) -> Future[np.ndarray] | None:
        if index >= len(self.stretches):
            return None
        return self._pool.submit(self._read, *self.stretches[index])

    def _read(self, first: int, count: int) -> np.ndarray:
        source = self.capture
        frames = np.empty((count, len(self.cameras), source.height, source.width, 3), np.uint8)
        for begin in range(0, count, CHUNK):
            if self._left.is_set():
                raise CancelledError
            part = min(CHUNK, count - begin)
            frames[begin : begin + part] = source.read(first + begin, part, self.cameras)
        return frames
