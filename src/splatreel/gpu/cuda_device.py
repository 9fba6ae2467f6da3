"""An NVIDIA GPU through its driver and NVRTC, without Vulkan, the CUDA toolkit or torch for CUDA.

Kernels are translated from WGSL (`cuda_source.py`) and compiled when they are first used. All work is in the default stream, which runs
it in order.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from splatreel.base.errors import GpuError
from splatreel.gpu.adapters import Adapter
from splatreel.gpu.cuda_libraries import Compiler, CudaDevice, Driver
from splatreel.gpu.cuda_source import ENTRY, translate
from splatreel.gpu.device import Gpu, Kernel, Recording, read_shader

Call = tuple[Any, ...]
"""Name of a function of the driver, and its arguments."""


class CudaBuffer:
    """Memory of the device, in bytes. The memory is freed with the object."""

    def __init__(self, driver: Driver, context: int, size: int) -> None:
        """Allocate memory. Raise a `GpuError` if the device has no room."""
        driver.call("cuCtxSetCurrent", context)
        found = ctypes.c_uint64()
        driver.call("cuMemAlloc_v2", ctypes.byref(found), size)
        self.address, self.size = found, size
        weakref.finalize(self, _free, driver, context, found.value).atexit = False


class CudaUniform:
    """Bytes on the host that a kernel receives with each launch."""

    def __init__(self, data: bytes) -> None:
        self.data = ctypes.create_string_buffer(data, len(data))
        self.size = len(data)


class CudaGpu(Gpu):
    """An opened NVIDIA GPU."""

    def __init__(self, adapter: Adapter, group: int | None = None, subgroups: bool | None = None) -> None:
        """Open an adapter whose handle is a `CudaDevice`. Raise a `GpuError` if the driver fails."""
        super().__init__(adapter, group, subgroups)
        self.largest = adapter.limits["max-storage-buffer-binding-size"]
        handle: CudaDevice = adapter.handle
        assert handle.compiler is not None
        self._driver, self._capability = handle.driver, handle.capability
        self._compiler = Compiler(handle.compiler)
        self._prelude = read_shader("prelude.cu")
        self._context = self._driver.pointer("cuDevicePrimaryCtxRetain", handle.number)

    def call(self, *calls: Call) -> None:
        """Call functions of the driver on this device, one after another. Their errors are `GpuError`."""
        try:
            self._driver.call("cuCtxSetCurrent", self._context)  # which belongs to a thread
            for name, *arguments in calls:
                self._driver.call(name, *arguments)
        except GpuError as error:
            raise GpuError(f"{self.adapter.name}: the device was lost: {error}") from error

    def _allocate(self, size: int, label: str) -> CudaBuffer:
        try:
            buffer = CudaBuffer(self._driver, self._context, size)
        except GpuError as error:
            raise GpuError(f"{self.adapter.name}: no room for {label} of {size / 1e6:,.0f} MB: {error}") from error
        self.call(("cuMemsetD8_v2", buffer.address, 0, size))
        return buffer

    def uniform(self, array: np.ndarray) -> CudaUniform:
        """See `Gpu`."""
        return CudaUniform(array.tobytes())

    def write(self, buffer: CudaBuffer | CudaUniform, array: np.ndarray, offset: int = 0) -> None:
        """See `Gpu`."""
        data = np.ascontiguousarray(array)
        if offset + data.nbytes > buffer.size:
            raise GpuError(f"{self.adapter.name}: {data.nbytes} bytes do not fit at {offset} of {buffer.size}.")
        if isinstance(buffer, CudaUniform):
            ctypes.memmove(ctypes.addressof(buffer.data) + offset, data.ctypes.data, data.nbytes)
        else:
            self.call(("cuMemcpyHtoD_v2", buffer.address.value + offset, data.ctypes.data, data.nbytes))

    def read(self, buffer: CudaBuffer, dtype: Any, shape: Sequence[int]) -> np.ndarray:
        """See `Gpu`."""
        found = np.zeros(shape, dtype)
        if found.nbytes:
            self.call(("cuMemcpyDtoH_v2", found.ctypes.data, buffer.address.value, found.nbytes))
        return found

    def _compile(self, name: str, source: str) -> int:
        """Return the address of the loaded kernel."""
        binary = self._compiler.compile(self._prelude + translate(source), name, self._capability)
        try:
            self._driver.call("cuCtxSetCurrent", self._context)
            module = self._driver.pointer("cuModuleLoadData", binary)
            return self._driver.pointer("cuModuleGetFunction", module, ENTRY.encode())
        except GpuError as error:
            raise GpuError(f"{self.adapter.name}: kernel {name} cannot be loaded: {error}") from error

    def _bind(self, kernel: Kernel, buffers: Mapping[int, Any]) -> Any:
        """Return the addresses of the arguments: a buffer's address, or the values of a uniform."""
        ordered = [buffer for _, buffer in sorted(buffers.items())]
        places = [ctypes.addressof(each.data if isinstance(each, CudaUniform) else each.address) for each in ordered]
        return (ctypes.c_void_p * len(places))(*places)

    def record(self) -> CudaRecording:
        """See `Gpu`."""
        return CudaRecording(self)


class CudaRecording(Recording):
    """Calls of the driver."""

    def __init__(self, gpu: CudaGpu) -> None:
        super().__init__(gpu)
        self._gpu = gpu
        self._calls: list[Call] = []
        self._kept: list[Any] = []

    def run(self, kernel: Kernel, groups: tuple[int, int, int], buffers: Mapping[str, Any]) -> None:
        """See `Recording`."""
        if 0 not in groups:
            bound = self._gpu.bind(kernel, buffers)
            self._kept.append(buffers)  # until they are submitted
            threads = self._group, 1, 1
            self._calls.append(("cuLaunchKernel", kernel.program, *groups, *threads, 0, None, bound, None))

    def clear(self, buffer: CudaBuffer, offset: int, nbytes: int) -> None:
        """See `Recording`."""
        if nbytes:
            self._kept.append(buffer)
            self._calls.append(("cuMemsetD8Async", buffer.address.value + offset, 0, nbytes, None))

    def submit(self) -> None:
        """See `Recording`. A launch copies the values of uniforms."""
        self._gpu.call(*self._calls)
        self._calls.clear()
        self._kept.clear()


def _free(driver: Driver, context: int, address: int) -> None:
    """Free memory. That of a lost device is freed already."""
    try:
        driver.call("cuCtxSetCurrent", context)
        driver.call("cuMemFree_v2", address)
    except GpuError:
        return
