"""Running mean of a keyframe's points over the last iterations."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

AVERAGE_EVERY = 4
"""Iterations between two samples of the mean. Neighboring iterations hardly differ."""


class Average:
    """Running mean of arrays over the last `share` of the iterations. Programs compute it from the weights of its samples.

    Source:
        Polyak averaging; for networks, Izmailov et al. 2018.
    """

    def __init__(self, share: float, iterations: int) -> None:
        """Prepare an average.

        Args:
            share: Share of the iterations that is averaged.
            iterations: Iterations of training.
        """
        self.after = iterations - round(share * iterations)
        self._means: list[np.ndarray] = []
        self._count = 0

    def has_begun(self, done: int) -> bool:
        """Return whether averaging has begun. done: number of finished iterations."""
        return done > self.after

    def restart(self) -> None:
        """Forget all samples, after rows were added or removed."""
        self._means = []
        self._count = 0

    def next_weight(self, done: int) -> float:
        """Count the values after an iteration. Return their weight in the mean; 0 if they are not a sample."""
        if not self.has_begun(done) or done % AVERAGE_EVERY:
            return 0.0
        self._count += 1
        return 1 / self._count

    def set_means(self, means: list[np.ndarray]) -> None:
        """Take over means that a program computed; does nothing without samples."""
        if self._count:
            self._means = means

    def write_to(self, arrays: Iterable[np.ndarray]) -> None:
        """Write the mean to the arrays, if it has their shapes."""
        now = list(arrays)
        if [mean.shape for mean in self._means] == [array.shape for array in now]:
            for array, mean in zip(now, self._means, strict=True):
                array[:] = mean
