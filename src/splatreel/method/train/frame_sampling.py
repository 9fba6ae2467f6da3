"""Order of training images: progressive frame sampling (paper section 4.2), then rounds over all images."""

from __future__ import annotations

import numpy as np

LEAST_DRAWS, MOST_DRAWS = 0.5, 3.0
"""Range of how often a frame is drawn per round."""


class FrameSchedule:
    """Sampler of frames and cameras.

    Frames are added in temporal order over the first `progressive` share of training. Meanwhile a third of the draws goes to
    the last three frames, which have the largest error. After that every image is drawn about once per round, in random order;
    frames with a larger loss in earlier rounds are drawn more often.
    """

    FRONTIER_SHARE = 0.35
    FRONTIER_FRAMES = 3

    def __init__(self, available: np.ndarray, iterations: int, progressive: float, seed: int) -> None:
        """Create a schedule.

        Args:
            available: [T, C] bool, images that exist. Every frame has one.
            iterations: Iterations of training.
            progressive: Share of training over which frames are added.
            seed: Seed of all draws.
        """
        self.available = available
        self.frames, self.cameras = available.shape
        self.warm = progressive * iterations
        self.rng = np.random.default_rng(seed)
        self._round: list[int] = []
        self._losses = np.full(available.shape, np.nan, np.float32)

    def frontier(self, iteration: int) -> int:
        """Return the last frame that may be drawn: floor(T n / N) of the paper."""
        if iteration >= self.warm:
            return self.frames - 1
        return min(self.frames - 1, int(self.frames * iteration / self.warm))

    def waits_for_losses(self, iteration: int) -> bool:
        """Return whether the draw of an iteration depends on the losses of all draws before it: at the start of a round."""
        return iteration >= self.warm and not self._round

    def draw(self, iteration: int) -> tuple[int, int]:
        """Return the frame and the camera of an iteration. Missing images are drawn again."""
        while True:
            frame, camera = self._draw(iteration)
            if self.available[frame, camera]:
                return frame, camera

    def _draw(self, iteration: int) -> tuple[int, int]:
        """Return a frame and a camera whose image may be missing."""
        if iteration < self.warm:
            return self._near(self.frontier(iteration)), int(self.rng.integers(self.cameras))
        if not self._round:
            copies = np.floor(
                np.repeat(self.draws_per_round(), self.cameras) + self.rng.random(self.frames * self.cameras)
            )
            images = np.repeat(np.arange(self.frames * self.cameras), copies.astype(np.int64))
            self._round = self.rng.permutation(images).tolist() or [int(self.rng.integers(self.frames * self.cameras))]
        return divmod(self._round.pop(), self.cameras)

    def record_loss(self, frame: int, camera: int, loss: float) -> None:
        """Record the loss of an image."""
        self._losses[frame, camera] = loss

    def draws_per_round(self) -> np.ndarray:
        """Return how often each frame is drawn per round, [T], mean 1: its loss relative to other frames of the same cameras."""
        losses = self._losses.astype(np.float64)
        seen = np.isfinite(losses)
        mean = np.where(seen, losses, 0).sum(0) / np.maximum(seen.sum(0), 1)
        relative = np.where(seen, losses / np.maximum(mean, 1e-12), 0).sum(1) / np.maximum(seen.sum(1), 1)
        share = np.where(seen.any(1), np.clip(relative, LEAST_DRAWS, MOST_DRAWS), 1.0)
        return share / share.mean()

    def _near(self, last: int) -> int:
        """Draw a frame up to `last`."""
        if self.rng.random() < self.FRONTIER_SHARE:
            return max(0, last - int(self.rng.integers(self.FRONTIER_FRAMES)))
        return int(self.rng.integers(last + 1))
