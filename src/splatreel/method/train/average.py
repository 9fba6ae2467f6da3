"""Running mean of a keyframe's points over the last iterations."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

AVERAGE_EVERY = 4
"""Iterations between two samples of the mean. Neighboring iterations hardly differ."""


class Average:
    """Running mean of tensors over the last `share` of the iterations. It restarts when rows are added or removed.

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
        self._means: list[Tensor] = []
        self._count = 0

    def has_begun(self, done: int) -> bool:
        """Return whether averaging has begun. done: number of finished iterations."""
        return done > self.after

    @torch.no_grad()
    def add(self, done: int, tensors: Iterable[Tensor]) -> None:
        """Add the values after an iteration."""
        if done % AVERAGE_EVERY:
            return
        now = [tensor.detach() for tensor in tensors]
        if [mean.shape for mean in self._means] != [tensor.shape for tensor in now]:
            self._means = [tensor.clone() for tensor in now]
            self._count = 0
        self._count += 1
        for mean, tensor in zip(self._means, now, strict=True):
            mean.lerp_(tensor, 1 / self._count)

    def restart(self) -> None:
        """Forget all samples."""
        self._means = []
        self._count = 0

    def next_weight(self, done: int) -> float:
        """Count the values after an iteration. Return their weight in the mean; 0 if they are not a sample."""
        if not self.has_begun(done) or done % AVERAGE_EVERY:
            return 0.0
        self._count += 1
        return 1 / self._count

    def set_means(self, means: list[Tensor]) -> None:
        """Take over means that a program computed; does nothing without samples."""
        if self._count:
            self._means = means

    @torch.no_grad()
    def write_to(self, tensors: Iterable[Tensor]) -> None:
        """Write the mean to the tensors, if it has their shapes."""
        now = list(tensors)
        if [mean.shape for mean in self._means] == [tensor.shape for tensor in now]:
            for tensor, mean in zip(now, self._means, strict=True):
                tensor.copy_(mean)
