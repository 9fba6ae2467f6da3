"""Which frame and which camera an iteration looks at: progressive frame sampling (paper section 4.2), then rounds of all pictures."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

LEAST_DRAWS, MOST_DRAWS = 0.5, 3.0
"""How often a frame comes up in a round, at least and at most."""


class FrameSchedule:
    """Frames are let in from near to far over the first `progressive` share of training; then all pictures come in rounds.

    While the frontier moves, a third of the draws goes to its last three frames: they are the ones that are still wrong. In a round
    every picture comes up about once, in random order: as often as its frame is worse than the others were in the rounds before.
    """

    FRONTIER_SHARE = 0.35
    FRONTIER_FRAMES = 3

    def __init__(self, frames: int, cameras: int, iterations: int, progressive: float, seed: int) -> None:
        self.frames, self.cameras = frames, cameras
        self.warm = progressive * iterations
        self.rng = np.random.default_rng(seed)
        self._round: list[int] = []
        self._losses: Tensor | None = None

    def frontier(self, iteration: int) -> int:
        """Last frame that may be drawn: floor(T n / N) of the paper."""
        if iteration >= self.warm:
            return self.frames - 1
        return min(self.frames - 1, int(self.frames * iteration / self.warm))

    def draw(self, iteration: int) -> tuple[int, int]:
        """Frame and camera."""
        if iteration < self.warm:
            return self._near(self.frontier(iteration)), int(self.rng.integers(self.cameras))
        if not self._round:
            copies = np.floor(np.repeat(self.wanted(), self.cameras) + self.rng.random(self.frames * self.cameras))
            pictures = np.repeat(np.arange(self.frames * self.cameras), copies.astype(np.int64))
            self._round = self.rng.permutation(pictures).tolist() or [
                int(self.rng.integers(self.frames * self.cameras))
            ]
        return divmod(self._round.pop(), self.cameras)

    def note(self, frame: int, camera: int, loss: Tensor) -> None:
        """What the loss of a picture was when it came up; stays on the device of the loss until a round is over."""
        if self._losses is None:
            self._losses = torch.full((self.frames, self.cameras), torch.nan, device=loss.device)
        self._losses[frame, camera] = loss.detach()

    def wanted(self) -> np.ndarray:
        """[T] how often each frame shall come up in a round, 1 in the mean: its loss by that of its cameras in other frames."""
        share = np.ones(self.frames)
        if self._losses is not None:
            losses = self._losses.cpu().numpy().astype(np.float64)
            seen = np.isfinite(losses)
            mean = np.where(seen, losses, 0).sum(0) / np.maximum(seen.sum(0), 1)
            relative = np.where(seen, losses / np.maximum(mean, 1e-12), 0).sum(1) / np.maximum(seen.sum(1), 1)
            share = np.where(seen.any(1), np.clip(relative, LEAST_DRAWS, MOST_DRAWS), 1.0)
        return share / share.mean()

    def _near(self, last: int) -> int:
        if self.rng.random() < self.FRONTIER_SHARE:
            return max(0, last - int(self.rng.integers(self.FRONTIER_FRAMES)))
        return int(self.rng.integers(last + 1))
