"""Adam of many tensors in one go: a numba kernel on the CPU, torch on CUDA."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from splatreel.kernels import twin
from splatreel.kernels.cpu import adam as kernel
from splatreel.kernels.twin import Step, Trained

__all__ = ["Step", "Trained", "adam"]


def adam(steps: Sequence[Step]) -> None:
    """One step of Adam for each of these tensors, in place."""
    if steps and steps[0].gradient.is_cuda:
        twin.adam(steps)
    elif steps:
        kernel.step([_flat(*step) for step in steps])


def _flat(trained: Trained, gradient: Tensor, factors, start: int, end: int, moment) -> kernel.Flat:
    size = gradient[0].numel() if len(gradient) else 0
    p, m, s = trained.flat
    if end < len(trained.parameter):
        p, m, s = p[: end * size], m[: end * size], s[: end * size]
    return kernel.Flat(p, m, s, gradient.contiguous().numpy().reshape(-1), factors, start * size, moment)
