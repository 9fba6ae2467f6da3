"""A GPU through wgpu: Vulkan, Metal or Direct3D 12."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import wgpu

from splatreel.base.errors import GpuError
from splatreel.gpu.adapters import Adapter
from splatreel.gpu.device import Gpu, Kernel, Recording

LIMITS = (
    "max-storage-buffer-binding-size",
    "max-buffer-size",
    "max-storage-buffers-per-shader-stage",
    "max-compute-workgroup-storage-size",
    "max-compute-invocations-per-workgroup",
    "max-compute-workgroup-size-x",
)
"""Limits that are raised to what the adapter has."""
ERRORS: tuple[type[Exception], ...] = (wgpu.GPUError, RuntimeError)
"""Errors that wgpu raises."""


class WgpuGpu(Gpu):
    """An opened adapter of wgpu."""

    def __init__(
        self,
        adapter: Adapter,
        group: int | None = None,
        subgroups: bool | None = None,
        limits: Mapping[str, int] | None = None,
    ) -> None:
        """Open an adapter, see `Gpu`.

        `limits` are asked for; None asks for all that the adapter has. The driver may raise a `GpuError`.
        """
        super().__init__(adapter, group, subgroups)
        asked = {name: adapter.limits[name] for name in LIMITS if name in adapter.limits}
        try:
            self.device = adapter.handle.request_device_sync(
                required_features=["subgroup"] if self.subgroups else [],
                required_limits=asked if limits is None else dict(limits),
            )
        except ERRORS as error:
            raise GpuError(f"{adapter.name}: the driver opens no device: {error}") from error
        granted = self.device.limits
        self.largest = int(min(granted["max-storage-buffer-binding-size"], granted["max-buffer-size"]))

    def _allocate(self, size: int, label: str) -> Any:
        usage = wgpu.BufferUsage.STORAGE | wgpu.BufferUsage.COPY_SRC | wgpu.BufferUsage.COPY_DST
        try:
            return self.device.create_buffer(size=size, usage=usage)
        except ERRORS as error:
            raise GpuError(f"{self.adapter.name}: no room for {label} of {size / 1e6:,.0f} MB: {error}") from error

    def uniform(self, array: np.ndarray) -> Any:
        """See `Gpu`."""
        usage = wgpu.BufferUsage.UNIFORM | wgpu.BufferUsage.COPY_DST
        buffer = self.device.create_buffer(size=array.nbytes, usage=usage)
        self.write(buffer, array)
        return buffer

    def write(self, buffer: Any, array: np.ndarray, offset: int = 0) -> None:
        """See `Gpu`."""
        try:
            self.device.queue.write_buffer(buffer, offset, np.ascontiguousarray(array).reshape(-1).view(np.uint8))
        except ERRORS as error:
            raise GpuError(f"{self.adapter.name}: copying to the device failed: {error}") from error

    def read(self, buffer: Any, dtype: Any, shape: Sequence[int]) -> np.ndarray:
        """See `Gpu`."""
        count = int(np.prod(shape))
        if count == 0:
            return np.zeros(shape, dtype)
        nbytes = -(-count * np.dtype(dtype).itemsize // 4) * 4
        try:
            data = self.device.queue.read_buffer(buffer, 0, nbytes)
        except ERRORS as error:
            raise GpuError(f"{self.adapter.name}: the device was lost: {error}") from error
        return np.frombuffer(data, dtype, count).reshape(shape).copy()

    def _compile(self, name: str, source: str) -> Any:
        try:
            module = self.device.create_shader_module(code=source, label=name)
            stage = {"module": module, "entry_point": "main"}
            return self.device.create_compute_pipeline(layout="auto", compute=stage)
        except ERRORS as error:
            raise GpuError(f"{self.adapter.name}: kernel {name} does not compile: {error}") from error

    def _bind(self, kernel: Kernel, buffers: Mapping[int, Any]) -> Any:
        entries = [{"binding": number, "resource": {"buffer": buffer}} for number, buffer in buffers.items()]
        layout = kernel.program.get_bind_group_layout(0)
        try:
            return self.device.create_bind_group(layout=layout, entries=entries)
        except ERRORS as error:
            raise GpuError(f"{self.adapter.name}: kernel {kernel.name} cannot use its buffers: {error}") from error

    def record(self) -> WgpuRecording:
        """See `Gpu`."""
        return WgpuRecording(self)


class WgpuRecording(Recording):
    """A command buffer."""

    def __init__(self, gpu: WgpuGpu) -> None:
        super().__init__(gpu)
        self._gpu = gpu
        self._encoder = gpu.device.create_command_encoder()
        self._pass: Any = None

    def run(self, kernel: Kernel, groups: tuple[int, int, int], buffers: Mapping[str, Any]) -> None:
        """See `Recording`."""
        if 0 in groups:
            return
        bound = self._gpu.bind(kernel, buffers)
        if self._pass is None:
            self._pass = self._encoder.begin_compute_pass()
        self._pass.set_pipeline(kernel.program)
        self._pass.set_bind_group(0, bound)
        self._pass.dispatch_workgroups(*groups)

    def clear(self, buffer: Any, offset: int, nbytes: int) -> None:
        """See `Recording`."""
        self._end()
        if nbytes:
            self._encoder.clear_buffer(buffer, offset, nbytes)

    def submit(self) -> None:
        """See `Recording`."""
        self._end()
        try:
            self._gpu.device.queue.submit([self._encoder.finish()])
        except ERRORS as error:
            raise GpuError(f"{self._gpu.adapter.name}: the device was lost: {error}") from error

    def _end(self) -> None:
        if self._pass is not None:
            self._pass.end()
            self._pass = None
