"""A software adapter for tests (Debian: mesa-vulkan-drivers and libvulkan1); tests skip with a line where there is none."""

from functools import cache

import pytest

from splatreel.gpu.adapters import Adapter, adapters, choose_adapter
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.gpu.wgpu_device import WgpuGpu


@cache
def software_adapter() -> Adapter:
    adapter, why = choose_adapter(adapters(), software=True)
    if adapter is None:
        pytest.skip(f"no adapter for wgpu: {why} Debian's mesa-vulkan-drivers and libvulkan1 bring a software adapter.")
    return adapter


@cache
def software_gpu(group: int = 64, subgroups: bool = True) -> WgpuGpu:
    return WgpuGpu(software_adapter(), group=group, subgroups=subgroups)


class SoftwareGpu(SharedGpu):
    """The software adapter, opened once for all tests of a process."""

    def __init__(self) -> None:
        super().__init__(software_adapter())
        self._gpu = software_gpu()
