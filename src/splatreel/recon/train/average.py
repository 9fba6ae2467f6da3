"""The mean of what is trained over the last iterations: it is where training went, without the noise of its last steps."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

EVERY = 4
"""Iterations between two that count: neighbors hardly differ."""


class Average:
    """Running mean of tensors over the last `share` of the iterations (Polyak averaging; for networks, Izmailov et al. 2018).

    It starts anew where rows come or go.
    """

    def __init__(self, share: float, iterations: int) -> None:
        self.after = iterations - round(share * iterations)
        self._means: list[Tensor] = []
        self._count = 0

    def runs(self, done: int) -> bool:
        """Whether an iteration is one of the last. done: iterations with this one."""
        return done > self.after

    @torch.no_grad()
    def add(self, done: int, tensors: Iterable[Tensor]) -> None:
        """Let the values after an iteration count."""
        if done % EVERY:
            return
        now = [tensor.detach() for tensor in tensors]
        if [mean.shape for mean in self._means] != [tensor.shape for tensor in now]:
            self._means, self._count = [tensor.clone() for tensor in now], 0
        self._count += 1
        for mean, tensor in zip(self._means, now, strict=True):
            mean.lerp_(tensor, 1 / self._count)

    @torch.no_grad()
    def settle(self, tensors: Iterable[Tensor]) -> None:
        """Write the mean to the tensors, if there is one of their rows."""
        now = list(tensors)
        if [mean.shape for mean in self._means] == [tensor.shape for tensor in now]:
            for tensor, mean in zip(now, self._means, strict=True):
                tensor.copy_(mean)
