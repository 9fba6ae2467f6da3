"""The table of backends. A new backend, such as Vulkan, is one class and one line here."""

from __future__ import annotations

from torch import Tensor

from splatreel.base.errors import GaussiansError
from splatreel.kernels.backend import Backend
from splatreel.kernels.cpu_backend import CpuBackend
from splatreel.kernels.cuda_backend import CudaBackend

BACKENDS: dict[str, Backend] = {"cpu": CpuBackend(), "cuda": CudaBackend()}
"""Backend for each device type of torch."""


def backend_of(tensor: Tensor) -> Backend:
    """Return the backend for a tensor's device.

    Raises:
        GaussiansError: There are no kernels for the device.
    """
    kind = tensor.device.type
    if kind not in BACKENDS:
        raise GaussiansError(f"There are no kernels for tensors on {kind}. Move them to one of: {', '.join(BACKENDS)}.")
    return BACKENDS[kind]
