"""A GPU through wgpu: Vulkan or Metal."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator, Mapping, Sequence
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
_SILENT = logging.NullHandler()


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
        logging.getLogger("wgpu").addHandler(_SILENT)  # what it reports is raised, too
        with self.errors("the driver opens no device"):
            self.device = adapter.handle.request_device_sync(
                required_features=["subgroup"] if self.subgroups else [],
                required_limits=asked if limits is None else dict(limits),
            )
        granted = self.device.limits
        self.largest = int(min(granted["max-storage-buffer-binding-size"], granted["max-buffer-size"]))

    @contextlib.contextmanager
    def errors(self, failure: str) -> Iterator[None]:
        """Turn all errors of wgpu into a `GpuError`. All calls of wgpu stand in such a block.

        failure: what fails, for the user; a lost device has its own sentence. The cause of the error has wgpu's text.
        """
        try:
            yield
        except (wgpu.GPUError, RuntimeError) as error:
            what = "the device was lost" if "lost" in str(error).lower() else failure
            raise GpuError(f"{self.adapter.name}: {what}.") from error

    def _allocate(self, size: int, label: str) -> Any:
        usage = wgpu.BufferUsage.STORAGE | wgpu.BufferUsage.COPY_SRC | wgpu.BufferUsage.COPY_DST
        with self.errors(f"no room for {label} of {size / 1e6:,.0f} MB"):
            return self.device.create_buffer(size=size, usage=usage)

    def uniform(self, array: np.ndarray) -> Any:
        """See `Gpu`."""
        with self.errors("no room for the numbers of a draw"):
            usage = wgpu.BufferUsage.UNIFORM | wgpu.BufferUsage.COPY_DST
            buffer = self.device.create_buffer(size=array.nbytes, usage=usage)
        self.write(buffer, array)
        return buffer

    def write(self, buffer: Any, array: np.ndarray, offset: int = 0) -> None:
        """See `Gpu`."""
        with self.errors("copying to the device failed"):
            self.device.queue.write_buffer(buffer, offset, np.ascontiguousarray(array).reshape(-1).view(np.uint8))

    def read(self, buffer: Any, dtype: Any, shape: Sequence[int]) -> np.ndarray:
        """See `Gpu`."""
        count = int(np.prod(shape))
        if count == 0:
            return np.zeros(shape, dtype)
        nbytes = -(-count * np.dtype(dtype).itemsize // 4) * 4
        with self.errors("copying from the device failed"):
            data = self.device.queue.read_buffer(buffer, 0, nbytes)
        return np.frombuffer(data, dtype, count).reshape(shape).copy()

    def _compile(self, name: str, source: str) -> Any:
        with self.errors(f"kernel {name} does not compile"):
            module = self.device.create_shader_module(code=source, label=name)
            stage = {"module": module, "entry_point": "main"}
            return self.device.create_compute_pipeline(layout="auto", compute=stage)

    def _bind(self, kernel: Kernel, buffers: Mapping[int, Any]) -> Any:
        entries = [{"binding": number, "resource": {"buffer": buffer}} for number, buffer in buffers.items()]
        with self.errors(f"kernel {kernel.name} cannot use its buffers"):
            layout = kernel.program.get_bind_group_layout(0)
            return self.device.create_bind_group(layout=layout, entries=entries)

    def record(self) -> WgpuRecording:
        """See `Gpu`."""
        return WgpuRecording(self)


class WgpuRecording(Recording):
    """A command buffer."""

    def __init__(self, gpu: WgpuGpu) -> None:
        super().__init__(gpu)
        self._gpu = gpu
        with gpu.errors("no list of dispatches can be made"):
            self._encoder = gpu.device.create_command_encoder()
        self._pass: Any = None

    def run(self, kernel: Kernel, groups: tuple[int, int, int], buffers: Mapping[str, Any]) -> None:
        """See `Recording`."""
        if 0 in groups:
            return
        bound = self._gpu.bind(kernel, buffers)
        with self._gpu.errors(f"kernel {kernel.name} cannot run"):
            if self._pass is None:
                self._pass = self._encoder.begin_compute_pass()
            self._pass.set_pipeline(kernel.program)
            self._pass.set_bind_group(0, bound)
            self._pass.dispatch_workgroups(*groups)

    def clear(self, buffer: Any, offset: int, nbytes: int) -> None:
        """See `Recording`."""
        with self._gpu.errors("a buffer cannot be cleared"):
            self._end()
            if nbytes:
                self._encoder.clear_buffer(buffer, offset, nbytes)

    def submit(self) -> None:
        """See `Recording`."""
        with self._gpu.errors("the work cannot be started"):
            self._end()
            self._gpu.device.queue.submit([self._encoder.finish()])

    def _end(self) -> None:
        if self._pass is not None:
            self._pass.end()
            self._pass = None
