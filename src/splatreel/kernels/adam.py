"""Adam of many tensors in one go: a numba kernel on the CPU, torch on CUDA."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from splatreel.kernels import twin
from splatreel.kernels.cpu import adam as kernel
from splatreel.kernels.twin import Step


def adam(steps: Sequence[Step]) -> None:
    """One step of Adam for each of these tensors, in place."""
    if steps and steps[0].parameter.is_cuda:
        twin.adam(steps)
    elif steps:
        kernel.step([_flat(*step) for step in steps])


def _flat(parameter: Tensor, mean: Tensor, square: Tensor, gradient: Tensor, factors, start, moment) -> kernel.Flat:
    tensors = parameter, mean, square, gradient.contiguous()
    p, m, s, g = (tensor.numpy().reshape(-1) for tensor in tensors)
    return kernel.Flat(p, m, s, g, factors, start * (p.size // max(len(parameter), 1)), moment)
