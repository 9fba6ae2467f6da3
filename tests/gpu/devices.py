"""The interfaces on which tests run kernels, and why one is left out."""

from functools import cache

import pytest

from splatreel.gpu.adapters import CUDA, Adapter, adapters, choose_adapter
from splatreel.gpu.cuda_device import CudaGpu
from splatreel.gpu.device import Gpu
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.gpu.wgpu_device import WgpuGpu
from tests.gpu.emulated import emulated_adapter


@cache
def software_adapter() -> Adapter:
    """Return an adapter of wgpu, a software adapter if there is no other one."""
    adapter, why = choose_adapter([each for each in adapters() if each.interface != CUDA], software=True)
    if adapter is None:
        pytest.skip(f"no adapter for wgpu: {why} Debian's mesa-vulkan-drivers and libvulkan1 bring a software adapter.")
    return adapter


@cache
def software_gpu(group: int = 64, subgroups: bool = True) -> WgpuGpu:
    return WgpuGpu(software_adapter(), group=group, subgroups=subgroups)


@cache
def emulated_gpu(group: int = 64, subgroups: bool = True) -> CudaGpu:
    """Return an NVIDIA GPU that this processor emulates."""
    return CudaGpu(emulated_adapter(), group, subgroups)


@cache
def nvidia_gpu(group: int = 64, subgroups: bool = True) -> CudaGpu:
    """Return an NVIDIA GPU of this machine."""
    adapter, why = choose_adapter([each for each in adapters() if each.interface == CUDA])
    if adapter is None:
        pytest.skip(f"no NVIDIA GPU for NVRTC: {why}")
    return CudaGpu(adapter, group, subgroups)


REAL = [pytest.param(software_gpu, id="wgpu"), pytest.param(nvidia_gpu, id="NVRTC")]
"""Functions that open a GPU. Arguments: threads of a workgroup; use subgroups."""
DEVICES = [
    *REAL,
    pytest.param(emulated_gpu, id="emulated NVIDIA GPU", marks=pytest.mark.slow),  # g++ compiles the kernels
]
"""The same, and the emulated GPU."""


class OpenedGpu(SharedGpu):
    """A GPU that is opened once for all tests of a process; by default the software adapter."""

    def __init__(self, gpu: Gpu | None = None) -> None:
        super().__init__((gpu or software_gpu()).adapter)
        self._gpu = gpu or software_gpu()
