"""Reading of a capture's frames ahead of their use, and of median images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from threading import Event

import numpy as np

from splatreel.base.paged_arrays import frame_array, release_pages
from splatreel.capture.base import Capture

CHUNK = 4
"""Frames decoded between checks whether the result is still needed, so that Ctrl-C takes effect quickly."""


class FramePrefetcher:
    """Context manager that iterates over stretches of a capture, with the next one decoded in a thread.

    It yields uint8 [count, len(cameras), H, W, 3] (`frame_array`). At most two stretches are in memory. Errors of the
    capture are raised by the iteration.

    Args:
        capture: Capture to read.
        cameras: Names of cameras.
        stretches: First frame and count of each stretch. The thread may wait for the next one to be known.
        ahead: False decodes a stretch only when it is requested.
        shared: Frames at the end of a stretch that are reused as the start of the next one.
    """

    def __init__(
        self,
        capture: Capture,
        cameras: list[str],
        stretches: Iterable[tuple[int, int]],
        *,
        ahead: bool = True,
        shared: int = 0,
    ) -> None:
        self.capture = capture
        self.cameras = cameras
        self.ahead = ahead
        self.shared = shared
        self._stretches = iter(stretches)
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="decode")
        self._left = Event()
        self._kept: tuple[int, np.ndarray] = 0, np.zeros(0)  # (first, frames)

    def __enter__(self) -> FramePrefetcher:
        return self

    def __exit__(self, *_: object) -> None:
        self._left.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def __iter__(self) -> Iterator[np.ndarray]:
        next_one = self._pool.submit(self._read_next)
        while (frames := next_one.result()) is not None:
            if self.ahead:
                next_one = self._pool.submit(self._read_next)
            yield frames
            if not self.ahead:
                next_one = self._pool.submit(self._read_next)

    def _read_next(self) -> np.ndarray | None:
        stretch = next(self._stretches, None)
        return None if stretch is None else self._read(*stretch)

    def _read(self, first: int, count: int) -> np.ndarray:
        source = self.capture
        frames = frame_array((count, len(self.cameras), source.height, source.width, 3))
        begin, kept = self._kept
        known = max(min(begin + len(kept) - first, count), 0) if begin <= first else 0
        frames[:known] = kept[first - begin :][:known] if known else 0
        for at in range(known, count, CHUNK):
            if self._left.is_set():
                raise CancelledError
            part = min(CHUNK, count - at)
            source.read_into(frames[at : at + part], first + at, self.cameras)
            release_pages(frames)
        shared = min(self.shared, count)
        # Copied, because the caller modifies its array.
        self._kept = first + count - shared, frames[count - shared :].copy()
        return frames


MOST_FRAMES = 20
"""Maximum number of frames for the median."""
THRESHOLD = 8 / 255
"""Mean absolute difference of the channels, 0..1, from the camera's median image, above which a pixel moves."""


def median_images(capture: Capture, names: Sequence[str], most: int = MOST_FRAMES) -> list[np.ndarray]:
    """Return the median of each named camera over the capture's frames, uint8 [H, W, 3].

    One camera's frames are in memory at a time.

    Args:
        capture: The capture.
        names: Names of the cameras.
        most: Maximum number of frames, evenly spread; of an even number the lower middle is used.
    """
    times = np.linspace(0, capture.frames - 1, min(most, capture.frames)).round().astype(int)
    middle = (len(times) - 1) // 2
    images = []
    for name in names:
        stack = np.stack([capture.read(int(time), 1, [name])[0, 0] for time in times])
        stack.partition(middle, axis=0)
        images.append(stack[middle].copy())
    return images


def moving_pixels(truth: np.ndarray, median: np.ndarray) -> np.ndarray:
    """Return the pixels where an image, float32 [H, W, 3] 0..1, differs from its camera's median, uint8 [H, W, 3], as [H, W] bool."""
    return np.abs(truth - median.astype(np.float32) / 255).mean(-1) > THRESHOLD
