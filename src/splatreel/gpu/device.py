"""A GPU through wgpu: buffers, kernels and dispatches; and the one GPU that all trainings of a process share."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from splatreel.base.errors import GpuError
from splatreel.gpu.adapters import Adapter

MOST_GROUPS = 65535
"""Largest number of workgroups along one axis, the minimum of WebGPU."""
LIMITS = (
    "max-storage-buffer-binding-size",
    "max-buffer-size",
    "max-storage-buffers-per-shader-stage",
    "max-compute-workgroup-storage-size",
    "max-compute-invocations-per-workgroup",
    "max-compute-workgroup-size-x",
)
"""Limits that are raised to what the adapter has."""
_BINDING = re.compile(r"@binding\((\d+)\) var<(storage, read_write|storage, read|uniform)> (\w+)")
_USES = re.compile(r"^// use: (.*)$", re.MULTILINE)
_SUBGROUP_CALL = "add_up(local, entry.y, sum0, sum1, sum2, lane, number, subgroups, k % 2u);"
_SUBGROUP_ARGUMENTS = (
    ": u32, @builtin(subgroup_invocation_id) lane: u32, @builtin(subgroup_id) number: u32, "
    "@builtin(num_subgroups) subgroups: u32"
)


class Kernel(NamedTuple):
    """A compiled kernel. bindings: names of its buffers by their numbers."""

    name: str
    pipeline: Any
    bindings: dict[int, str]


class Gpu:
    """An opened adapter.

    Attributes:
        adapter: The adapter.
        group: Threads of a workgroup.
        subgroups: Sums over a tile use subgroup operations.
        largest: Largest number of bytes of one buffer.
    """

    def __init__(
        self,
        adapter: Adapter,
        group: int | None = None,
        subgroups: bool | None = None,
        limits: Mapping[str, int] | None = None,
    ) -> None:
        """Open an adapter.

        Args:
            adapter: Adapter to open.
            group: Threads of a workgroup: 64, 128 or 256; None chooses.
            subgroups: Use subgroup operations; None uses them if there are any.
            limits: Limits to ask for; None asks for all that the adapter has.

        Raises:
            GpuError: The driver refuses.
        """
        import wgpu

        self.adapter = adapter
        self.group = group or 64
        self.subgroups = adapter.subgroups if subgroups is None else subgroups and adapter.subgroups
        asked = {name: adapter.limits[name] for name in LIMITS if name in adapter.limits}
        try:
            self.device = adapter.handle.request_device_sync(
                required_features=["subgroup"] if self.subgroups else [],
                required_limits=asked if limits is None else dict(limits),
            )
        except (RuntimeError, wgpu.GPUError) as error:
            raise GpuError(f"{adapter.name}: the driver opens no device: {error}") from error
        self.queue = self.device.queue
        granted = self.device.limits
        self.largest = int(min(granted["max-storage-buffer-binding-size"], granted["max-buffer-size"]))
        self._usage = wgpu.BufferUsage
        self._errors: tuple[type[Exception], ...] = (wgpu.GPUError, RuntimeError)
        self._kernels: dict[tuple[Any, ...], Kernel] = {}
        self._groups: dict[tuple[Any, ...], Any] = {}

    def zeros(self, nbytes: int, label: str = "a buffer") -> Any:
        """Return a storage buffer of zeros.

        Args:
            nbytes: Size; at least 64 bytes are allocated.
            label: Contents, for the error.

        Raises:
            GpuError: The device has no room, or does not allow a buffer of this size.
        """
        size = max(-(-nbytes // 64) * 64, 64)
        if size > self.largest:
            raise GpuError(
                f"{self.adapter.name}: {label} takes {size / 1e6:,.0f} MB, and a buffer may have {self.largest / 1e6:,.0f} MB."
            )
        usage = self._usage.STORAGE | self._usage.COPY_SRC | self._usage.COPY_DST
        try:
            return self.device.create_buffer(size=size, usage=usage)
        except self._errors as error:
            raise GpuError(f"{self.adapter.name}: no room for {label} of {size / 1e6:,.0f} MB: {error}") from error

    def upload(self, array: np.ndarray, label: str = "a buffer") -> Any:
        """Return a storage buffer with the bytes of an array."""
        data = np.ascontiguousarray(array)
        buffer = self.zeros(data.nbytes, label)
        if data.nbytes:
            self.write(buffer, data)
        return buffer

    def uniform(self, array: np.ndarray) -> Any:
        """Return a uniform buffer with the bytes of an array."""
        buffer = self.device.create_buffer(size=array.nbytes, usage=self._usage.UNIFORM | self._usage.COPY_DST)
        self.queue.write_buffer(buffer, 0, array.tobytes())
        return buffer

    def write(self, buffer: Any, array: np.ndarray, offset: int = 0) -> None:
        """Copy an array into a buffer, before all work that is submitted later. offset: bytes, a multiple of four."""
        try:
            self.queue.write_buffer(buffer, offset, np.ascontiguousarray(array).reshape(-1).view(np.uint8))
        except self._errors as error:
            raise GpuError(f"{self.adapter.name}: copying to the device failed: {error}") from error

    def read(self, buffer: Any, dtype: Any, shape: Sequence[int]) -> np.ndarray:
        """Wait for all submitted work, and return the first values of a buffer.

        Raises:
            GpuError: The device was lost.
        """
        count = int(np.prod(shape))
        if count == 0:
            return np.zeros(shape, dtype)
        nbytes = -(-count * np.dtype(dtype).itemsize // 4) * 4
        try:
            data = self.queue.read_buffer(buffer, 0, nbytes)
        except self._errors as error:
            raise GpuError(f"{self.adapter.name}: the device was lost: {error}") from error
        return np.frombuffer(data, dtype, count).reshape(shape).copy()

    def kernel(self, name: str, **constants: str | int) -> Kernel:
        """Compile a kernel of the folder `shaders`, once. constants: values of names that its source leaves open."""
        key = (name, *sorted(constants.items()))
        if key not in self._kernels:
            source = self.source(name, **constants)
            try:
                module = self.device.create_shader_module(code=source, label=name)
                stage = {"module": module, "entry_point": "main"}
                pipeline = self.device.create_compute_pipeline(layout="auto", compute=stage)
            except self._errors as error:
                raise GpuError(f"{self.adapter.name}: kernel {name} does not compile: {error}") from error
            found = {int(number): label for number, _, label in _BINDING.findall(source)}
            self._kernels[key] = Kernel(name, pipeline, found)
        return self._kernels[key]

    def source(self, name: str, **constants: str | int) -> str:
        """Return the complete source of a kernel."""
        text = read_shader(name)
        uses = [part.strip() for line in _USES.findall(text) for part in line.split(",")]
        declared = "".join(f"const {label} = {value};\n" for label, value in constants.items())
        if name == "backward":
            chosen = "subgroups" if self.subgroups else "tree"
            call = _SUBGROUP_CALL if self.subgroups else "add_up(local, entry.y, sum0, sum1, sum2);"
            arguments = _SUBGROUP_ARGUMENTS if self.subgroups else ": u32"
            text = text.replace("SUMS", read_shader(f"backward_{chosen}"))
            text = text.replace("REDUCE", call).replace("SUBGROUP_ARGUMENTS", arguments)
        parts = [f"const GROUP = {self.group}u;\n", declared, *map(read_shader, uses), text]
        return "\n".join(parts)

    def bind(self, kernel: Kernel, buffers: Mapping[str, Any]) -> Any:
        """Return the bind group of a kernel and its buffers, from a cache."""
        chosen = {number: buffers[label] for number, label in kernel.bindings.items()}
        key = (id(kernel.pipeline), *map(id, chosen.values()))
        if key not in self._groups:
            entries = [{"binding": number, "resource": {"buffer": buffer}} for number, buffer in chosen.items()]
            layout = kernel.pipeline.get_bind_group_layout(0)
            try:
                group = self.device.create_bind_group(layout=layout, entries=entries)
            except self._errors as error:
                raise GpuError(f"{self.adapter.name}: kernel {kernel.name} cannot use its buffers: {error}") from error
            self._groups[key] = group, tuple(chosen.values())  # the buffers stay alive, so that their ids stay theirs
        return self._groups[key][0]

    def forget_buffers(self) -> None:
        """Empty the cache of bind groups, so that buffers that are no longer used are freed."""
        self._groups.clear()

    def record(self) -> Recording:
        """Start a list of dispatches."""
        return Recording(self)


class SharedGpu:
    """An adapter that is opened when it is first used. After a failure, the process does not use it again.

    Attributes:
        adapter: The adapter.
        failure: What failed; None if nothing did.
    """

    def __init__(self, adapter: Adapter) -> None:
        """Choose an adapter, without opening it."""
        self.adapter = adapter
        self.failure: str | None = None
        self._gpu: Gpu | None = None

    def open(self) -> Gpu | None:
        """Return the opened device; None after a failure.

        Raises:
            GpuError: The driver refuses.
        """
        if self._gpu is None and self.failure is None:
            self._gpu = Gpu(self.adapter)
        return self._gpu

    def fail(self, error: GpuError) -> None:
        """Stop using the GPU."""
        self.failure = str(error)
        self._gpu = None


class Recording:
    """A list of dispatches, which run in order when they are submitted."""

    def __init__(self, gpu: Gpu) -> None:
        """Start an empty list."""
        self._gpu = gpu
        self._encoder = gpu.device.create_command_encoder()
        self._pass: Any = None

    def run(self, kernel: Kernel, groups: tuple[int, int, int], buffers: Mapping[str, Any]) -> None:
        """Add a dispatch. buffers: by the names in the kernel's source; others are ignored."""
        if 0 in groups:
            return
        bound = self._gpu.bind(kernel, buffers)
        if self._pass is None:
            self._pass = self._encoder.begin_compute_pass()
        self._pass.set_pipeline(kernel.pipeline)
        self._pass.set_bind_group(0, bound)
        self._pass.dispatch_workgroups(*groups)

    def run_each(self, kernel: Kernel, count: int, buffers: Mapping[str, Any], depth: int = 1) -> None:
        """Add a dispatch with a thread for each of `count` elements, `depth` times along the third axis."""
        groups = -(-count // self._gpu.group)
        rows = -(-groups // MOST_GROUPS)
        self.run(kernel, (-(-groups // max(rows, 1)), rows, depth), buffers)

    def clear(self, buffer: Any, offset: int, nbytes: int) -> None:
        """Set bytes of a buffer to zero."""
        self._end()
        if nbytes:
            self._encoder.clear_buffer(buffer, offset, nbytes)

    def copy(self, source: Any, target: Any, nbytes: int) -> None:
        """Copy the first bytes of a buffer to another one."""
        self._end()
        self._encoder.copy_buffer_to_buffer(source, 0, target, 0, nbytes)

    def submit(self) -> None:
        """Start the work, without waiting for its end.

        Raises:
            GpuError: The device was lost.
        """
        self._end()
        try:
            self._gpu.queue.submit([self._encoder.finish()])
        except self._gpu._errors as error:
            raise GpuError(f"{self._gpu.adapter.name}: the device was lost: {error}") from error

    def _end(self) -> None:
        if self._pass is not None:
            self._pass.end()
            self._pass = None


def read_shader(name: str) -> str:
    """Return the source of a file of the folder `shaders`."""
    return (resources.files("splatreel.gpu") / "shaders" / f"{name}.wgsl").read_text(encoding="utf-8")
