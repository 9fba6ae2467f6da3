"""Which frame an iteration looks at: progressive frame sampling (paper section 4.2)."""

from __future__ import annotations

import numpy as np


class FrameSchedule:
    """Frames are let in from near to far over the first `progressive` share of training, then drawn evenly.

    While the frontier moves, a third of the draws goes to its last three frames: they are the ones that are still wrong.
    """

    FRONTIER_SHARE = 0.35
    FRONTIER_FRAMES = 3

    def __init__(self, frames: int, iterations: int, progressive: float, seed: int) -> None:
        self.frames = frames
        self.warm = progressive * iterations
        self.rng = np.random.default_rng(seed)

    def frontier(self, iteration: int) -> int:
        """Last frame that may be drawn: floor(T n / N) of the paper."""
        if iteration >= self.warm:
            return self.frames - 1
        return min(self.frames - 1, int(self.frames * iteration / self.warm))

    def draw(self, iteration: int) -> int:
        last = self.frontier(iteration)
        if iteration < self.warm and self.rng.random() < self.FRONTIER_SHARE:
            return max(0, last - int(self.rng.integers(self.FRONTIER_FRAMES)))
        return int(self.rng.integers(last + 1))
