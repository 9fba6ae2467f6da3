"""Adapters of this machine: which ones there are, which one training would use, and why not the others."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from splatreel.base.errors import UsageError
from splatreel.gpu.cuda_libraries import CudaDevice, cuda_devices

CUDA = "CUDA"
"""Interface of adapters that NVIDIA's driver and run-time compiler (NVRTC) reach without Vulkan."""

LEAST = {
    "max-compute-invocations-per-workgroup": 64,
    "max-compute-workgroup-storage-size": 16384,
    "max-storage-buffers-per-shader-stage": 8,
    "max-storage-buffer-binding-size": 1 << 27,
}
"""Limits that training needs. They are the minimum of WebGPU, except that smaller workgroups are enough."""


@dataclass(frozen=True)
class Adapter:
    """A graphics processor, or a program that simulates one, through one of the system's interfaces.

    Attributes:
        interface: Vulkan, Metal, OpenGL or `CUDA`.
        kind: DiscreteGPU, IntegratedGPU, CPU or Unknown.
        limits: Limits by wgpu's names.
        handle: Adapter of wgpu, or a `CudaDevice`.
    """

    name: str
    interface: str
    kind: str
    limits: dict[str, int]
    subgroups: bool
    handle: Any

    @property
    def is_software(self) -> bool:
        """Return whether a program simulates the device on the CPU."""
        return self.kind == "CPU"

    @property
    def route(self) -> str:
        """Return how training reaches the adapter, for the user."""
        return f"{CUDA} and NVRTC" if self.interface == CUDA else self.interface

    @property
    def missing(self) -> str | None:
        """Return why training cannot use the adapter; None if it can."""
        if self.interface == "OpenGL":
            return "OpenGL lacks what training needs"
        if isinstance(self.handle, CudaDevice) and self.handle.missing is not None:
            return self.handle.missing
        for name, least in LEAST.items():
            if self.limits.get(name, 0) < least:
                return f"{name} is {self.limits.get(name, 0):,}, training needs {least:,}"
        return None


def is_installed() -> bool:
    """Return whether the package wgpu is installed."""
    return importlib.util.find_spec("wgpu") is not None


def may_have_gpu() -> bool:
    """Return whether a hardware GPU is possible. On Linux each one has a device file; looking at that saves loading wgpu, a second."""
    if sys.platform != "linux" or cuda_devices():
        return True
    return any(next(Path("/dev").glob(files), None) for files in ("dri/renderD*", "dxg", "kgsl-3d*", "mali*"))


@cache
def adapters() -> tuple[Adapter, ...]:
    """Look for the adapters of this machine, once, and return the fastest kinds first. Of one kind, those of wgpu are first."""
    found = [*_wgpu_adapters(), *map(_cuda_adapter, cuda_devices())]
    order = {"DiscreteGPU": 0, "IntegratedGPU": 1, "Unknown": 2, "CPU": 3}
    return tuple(sorted(found, key=lambda adapter: (adapter.missing is not None, order.get(adapter.kind, 2))))


def _wgpu_adapters() -> list[Adapter]:
    """Return the adapters of wgpu; none without the package or its driver."""
    if not is_installed():
        return []
    if sys.platform == "linux" and not {"XDG_RUNTIME_DIR", "MESA_VK_DEVICE_SELECT"} & set(os.environ):
        os.environ.setdefault("NODEVICE_SELECT", "1")  # without a desktop, this layer of Mesa only prints errors
    try:
        import wgpu
        from wgpu.backends.wgpu_native.extras import set_instance_extras

        # OpenGL lacks what training needs. The compiler that Windows brings for Direct3D 12 (FXC) has no subgroups and rejects barriers
        # in loops over a tile's splats; drivers for Windows have Vulkan.
        with contextlib.suppress(RuntimeError):  # the program that calls us has used wgpu before
            set_instance_extras(backends=("Vulkan", "Metal"))
        return [_adapter(handle) for handle in wgpu.gpu.enumerate_adapters_sync()]
    except (ImportError, OSError, RuntimeError):  # no library for this system, or no driver
        return []


def _adapter(handle: Any) -> Adapter:
    info, limits = handle.info, {name: int(value) for name, value in handle.limits.items()}
    return Adapter(
        info["device"], info["backend_type"], info["adapter_type"], limits, "subgroup" in handle.features, handle
    )


def _cuda_adapter(device: CudaDevice) -> Adapter:
    kind = "IntegratedGPU" if device.is_integrated else "DiscreteGPU"
    return Adapter(device.name, CUDA, kind, device.limits, True, device)


def choose_adapter(found: Sequence[Adapter], software: bool = False) -> tuple[Adapter | None, str]:
    """Return the adapter that training uses, if any, and a sentence that explains the choice.

    A `software` adapter is eligible after all others.
    """
    if not found and not is_installed():
        return None, "The package wgpu is not installed, and NVIDIA's driver was not found."
    if not found:
        return None, "No driver was found (Vulkan, Metal or NVIDIA's)."
    usable = [adapter for adapter in found if adapter.missing is None]
    if not usable:
        return None, f"{found[0].name} cannot be used: {found[0].missing}."
    eligible = [adapter for adapter in usable if software or not adapter.is_software]
    if not eligible:
        return None, f"{usable[0].name} is a software adapter, which is slower than our CPU kernels."
    return eligible[0], f"{eligible[0].name} through {eligible[0].route}."


def require_adapter() -> Adapter:
    """Return the adapter for `--device gpu`, software only where there is nothing else; raise a `UsageError` if there is none."""
    adapter, why = choose_adapter(adapters(), software=True)
    if adapter is None:
        raise UsageError(f"--device gpu: {why} Use --device cpu, or run `splatreel devices` to see what there is.")
    return adapter
