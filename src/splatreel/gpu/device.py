"""A GPU: buffers, kernels and dispatches, whatever interface it is reached through.

Kernels are WGSL files of the folder `shaders`, put together for one size of workgroups.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from splatreel.base.errors import GpuError
from splatreel.gpu.adapters import Adapter

BINDING = re.compile(r"@binding\((\d+)\) var<(storage, read_write|storage, read|uniform)> (\w+)")
_USES = re.compile(r"^// use: (.*)$", re.MULTILINE)
_SUBGROUP_CALL = "add_up(local, entry.y, sum0, sum1, sum2, lane, number, subgroups, turn); turn = 1u - turn;"
_SUBGROUP_ARGUMENTS = (
    ": u32, @builtin(subgroup_invocation_id) lane: u32, @builtin(subgroup_id) number: u32, "
    "@builtin(num_subgroups) subgroups: u32"
)


def read_shader(name: str) -> str:
    """Return the source of a file of the folder `shaders`. name: with its suffix, or without the suffix `.wgsl`."""
    file = name if "." in name else f"{name}.wgsl"
    return (resources.files("splatreel.gpu") / "shaders" / file).read_text(encoding="utf-8")


def complete_source(name: str, group: int, subgroups: bool, **constants: str | int) -> str:
    """Return the complete source of a kernel in `shaders`, for `group` threads. `constants` are names that the file leaves open."""
    text = read_shader(name)
    uses = [part.strip() for line in _USES.findall(text) for part in line.split(",")]
    declared = "".join(f"const {label} = {value};\n" for label, value in constants.items())
    if name == "backward":
        chosen = "subgroups" if subgroups else "tree"
        call = _SUBGROUP_CALL if subgroups else "add_up(local, entry.y, sum0, sum1, sum2);"
        arguments = _SUBGROUP_ARGUMENTS if subgroups else ": u32"
        text = text.replace("SUMS", read_shader(f"backward_{chosen}"))
        text = text.replace("REDUCE", call).replace("SUBGROUP_ARGUMENTS", arguments)
    return "\n".join([f"const GROUP = {group}u;\n", declared, *map(read_shader, uses), text])


MOST_GROUPS = 65535
"""Largest number of workgroups along one axis, the minimum of WebGPU."""


class Kernel(NamedTuple):
    """A compiled kernel. program: what the interface needs to run it. bindings: names of its buffers by their numbers."""

    name: str
    program: Any
    bindings: dict[int, str]


class Gpu(ABC):
    """An opened adapter. A subclass for each interface creates buffers and runs kernels.

    Attributes:
        group: Threads of a workgroup.
        subgroups: Sums over a tile use subgroup operations.
        largest: Largest number of bytes of one buffer. The subclass sets it.
    """

    largest: int

    def __init__(self, adapter: Adapter, group: int | None, subgroups: bool | None) -> None:
        """Note what an adapter can do.

        `group`: 64, 128 or 256 threads. `subgroups`: use subgroup operations, by default if there are any.
        """
        self.adapter = adapter
        self.group = group or 64
        self.subgroups = adapter.subgroups if subgroups is None else subgroups and adapter.subgroups
        self._kernels: dict[tuple[Any, ...], Kernel] = {}
        self._bound: dict[tuple[Any, ...], tuple[Any, tuple[Any, ...]]] = {}

    @abstractmethod
    def _allocate(self, size: int, label: str) -> Any:
        """Return a storage buffer of zeros with an attribute `size`, bytes, a multiple of 64; or raise a `GpuError`."""

    @abstractmethod
    def uniform(self, array: np.ndarray) -> Any:
        """Return a uniform buffer with the bytes of an array."""

    @abstractmethod
    def write(self, buffer: Any, array: np.ndarray, offset: int = 0) -> None:
        """Copy an array into a buffer, before all work that is submitted later. offset: bytes, a multiple of four."""

    @abstractmethod
    def read(self, buffer: Any, dtype: Any, shape: Sequence[int]) -> np.ndarray:
        """Wait for all submitted work, and return the first values of a buffer. A lost device raises a `GpuError`."""

    @abstractmethod
    def _compile(self, name: str, source: str) -> Any:
        """Compile the complete source of a kernel, or raise a `GpuError`."""

    @abstractmethod
    def _bind(self, kernel: Kernel, buffers: Mapping[int, Any]) -> Any:
        """Return a kernel's buffers, by their numbers, in the form in which a dispatch takes them."""

    @abstractmethod
    def record(self) -> Recording:
        """Start a list of dispatches."""

    def zeros(self, nbytes: int, label: str = "a buffer") -> Any:
        """Return a storage buffer of zeros of at least 64 bytes, or raise a `GpuError` that names its contents (`label`)."""
        size = max(-(-nbytes // 64) * 64, 64)
        if size > self.largest:
            raise GpuError(
                f"{self.adapter.name}: {label} takes {size / 1e6:,.0f} MB, and a buffer may have {self.largest / 1e6:,.0f} MB."
            )
        return self._allocate(size, label)

    def upload(self, array: np.ndarray, label: str = "a buffer") -> Any:
        """Return a storage buffer with the bytes of an array."""
        data = np.ascontiguousarray(array)
        buffer = self.zeros(data.nbytes, label)
        if data.nbytes:
            self.write(buffer, data)
        return buffer

    def kernel(self, name: str, **constants: str | int) -> Kernel:
        """Compile a kernel of the folder `shaders`, once. constants: values of names that its source leaves open."""
        key = (name, *sorted(constants.items()))
        if key not in self._kernels:
            source = complete_source(name, self.group, self.subgroups, **constants)
            found = {int(number): label for number, _, label in BINDING.findall(source)}
            self._kernels[key] = Kernel(name, self._compile(name, source), found)
        return self._kernels[key]

    def bind(self, kernel: Kernel, buffers: Mapping[str, Any]) -> Any:
        """Return a kernel's buffers in the form in which a dispatch takes them, from a cache."""
        chosen = {number: buffers[label] for number, label in kernel.bindings.items()}
        key = (id(kernel.program), *map(id, chosen.values()))
        if key not in self._bound:
            # the buffers stay alive, so that their ids stay theirs
            self._bound[key] = self._bind(kernel, chosen), tuple(chosen.values())
        return self._bound[key][0]

    def forget_buffers(self) -> None:
        """Empty the cache of `bind`, so that buffers that are no longer used are freed."""
        self._bound.clear()


class Recording(ABC):
    """A list of dispatches, which run in order when they are submitted."""

    def __init__(self, gpu: Gpu) -> None:
        self._group = gpu.group

    @abstractmethod
    def run(self, kernel: Kernel, groups: tuple[int, int, int], buffers: Mapping[str, Any]) -> None:
        """Add a dispatch. buffers: by the names in the kernel's source; others are ignored."""

    @abstractmethod
    def clear(self, buffer: Any, offset: int, nbytes: int) -> None:
        """Set bytes of a buffer to zero."""

    @abstractmethod
    def submit(self) -> None:
        """Start the work, without waiting for its end. A lost device raises a `GpuError`."""

    def run_each(self, kernel: Kernel, count: int, buffers: Mapping[str, Any], depth: int = 1) -> None:
        """Add a dispatch with a thread for each of `count` elements, `depth` times along the third axis."""
        groups = -(-count // self._group)
        rows = -(-groups // MOST_GROUPS)
        self.run(kernel, (-(-groups // max(rows, 1)), rows, depth), buffers)
