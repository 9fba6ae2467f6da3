"""The next group's frames are decoded while the current one trains."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from splatreel.capture.base import Capture


class FramePrefetcher:
    """Iterates over stretches of a capture, in order, one decoded ahead in a thread.

    stretches: (first, count) frames. Yields uint8 [count, len(cameras), H, W, 3]. At most two stretches are in memory: the one
    in use and the next. Raises where it is iterated what the capture raises. Use as a context manager.
    """

    def __init__(self, capture: Capture, cameras: list[str], stretches: list[tuple[int, int]]) -> None:
        self.capture, self.cameras, self.stretches = capture, cameras, stretches
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="decode")

    def __enter__(self) -> FramePrefetcher:
        return self

    def __exit__(self, *_: object) -> None:
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
        return self._pool.submit(self.capture.read, *self.stretches[index], self.cameras)
