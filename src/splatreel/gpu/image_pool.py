"""Training images on the GPU: a cache with a bound, four bytes a pixel."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np

from splatreel.base.errors import GpuError
from splatreel.gpu.device import Gpu

BOUND = 4e9
"""Bytes that images take on the device at most. A group of 35 frames of 20 cameras at 1352x1014 takes 3.8 GB."""
CHUNK = 2.5e8
"""Bytes of one buffer of images at most. Buffers are allocated when they are needed."""


class ImagePool:
    """Images of one size, in buffers with room for many. The one that was not used for the longest time is replaced."""

    def __init__(self, gpu: Gpu, width: int, height: int, count: int, bound: float = BOUND) -> None:
        """Make room.

        Args:
            gpu: Device.
            width: Pixels.
            height: Pixels.
            count: Number of different images.
            bound: Most bytes that the images take.
        """
        self._gpu = gpu
        self._bytes = 4 * width * height
        fits = max(int(min(bound // self._bytes, count)), 2)
        self._in_buffer = max(min(int(min(gpu.largest, CHUNK) // self._bytes), fits), 1)
        self._slots = -(-fits // self._in_buffer) * self._in_buffer
        self._buffers: list[Any] = []
        self._held: OrderedDict[tuple[int, int], int] = OrderedDict()

    def get(self, frame: int, camera: int, load: Callable[[], np.ndarray]) -> tuple[Any, int]:
        """Return the buffer of an image and the number of its first pixel there.

        Args:
            frame: Number of the frame.
            camera: Number of the camera.
            load: Returns the image [H, W, 4] uint8: color, and 0 where a pixel is known.
        """
        key = frame, camera
        if key in self._held:
            self._held.move_to_end(key)
        else:
            slot = self._free_slot()
            self._held[key] = slot
            self._gpu.write(self._buffers[slot // self._in_buffer], load(), slot % self._in_buffer * self._bytes)
        slot = self._held[key]
        return self._buffers[slot // self._in_buffer], slot % self._in_buffer * self._bytes // 4

    def _free_slot(self) -> int:
        """Return the number of a slot whose contents are no longer needed. Where memory is short, there are fewer slots."""
        if len(self._held) == self._in_buffer * len(self._buffers) and len(self._held) < self._slots:
            try:
                self._buffers.append(self._gpu.zeros(self._in_buffer * self._bytes, "the images"))
            except GpuError:
                if not self._buffers:
                    raise
                self._slots = len(self._held)
        return len(self._held) if len(self._held) < self._slots else self._held.popitem(last=False)[1]
