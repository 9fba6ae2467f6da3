"""The one GPU that all trainings of a process share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from splatreel.base.errors import GpuError
from splatreel.gpu.adapters import CUDA, Adapter
from splatreel.gpu.device import Gpu


class SharedGpu:
    """An adapter that is opened when it is first used. After a failure, the process does not use it again.

    Attributes:
        kind: Value of `--device` that chooses it: gpu, or cuda with gsplat.
        failure: What failed; None if nothing did.
    """

    def __init__(self, adapter: Adapter, opener: Callable[[Adapter], Any] | None = None, kind: str = "gpu") -> None:
        """Choose an adapter, without opening it. opener: function that opens it; None is `open_gpu`."""
        self.adapter = adapter
        self.kind = kind
        self.failure: str | None = None
        self._opener = opener
        self._gpu: Any = None

    def open(self) -> Any:
        """Return the opened device, a `Gpu` or one with programs of its own; None after a failure.

        The driver may raise a `GpuError`.
        """
        if self._gpu is None and self.failure is None:
            self._gpu = (self._opener or open_gpu)(self.adapter)
        return self._gpu

    def fail(self, error: GpuError) -> None:
        """Stop using the GPU."""
        self.failure = str(error)
        self._gpu = None


def open_gpu(adapter: Adapter) -> Gpu:
    """Open an adapter through its interface, and test it. Raise a `GpuError` if the driver fails or the device computes nonsense."""
    from splatreel.gpu.self_test import check_device

    if adapter.interface == CUDA:
        from splatreel.gpu.cuda_device import CudaGpu

        gpu: Gpu = CudaGpu(adapter)
    else:
        from splatreel.gpu.wgpu_device import WgpuGpu

        gpu = WgpuGpu(adapter)
    check_device(gpu)
    return gpu
