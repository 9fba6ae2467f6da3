"""NVIDIA GPUs that the driver knows, and why kernels cannot be compiled for one."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from splatreel.base.errors import GpuError
from splatreel.gpu.cuda_libraries import Driver, compiler_version, find_compilers

THREADS, SHARED_MEMORY, IS_INTEGRATED, MAJOR, MINOR = 1, 8, 18, 75, 76
"""Attributes of a device: the driver's CUdevice_attribute."""
LEAST_CAPABILITY = 70
"""Oldest compute capability that kernels are written for (Volta, 2017)."""
BUFFERS = 32
"""Storage buffers of a kernel. CUDA has no limit; this is more than WebGPU guarantees."""


@dataclass(frozen=True)
class CudaDevice:
    """A device of NVIDIA's driver.

    Attributes:
        name: Name of the device.
        number: Number of the device.
        capability: Compute capability, such as 90.
        is_integrated: The device shares the memory of the processor.
        limits: Limits by wgpu's names.
        driver: The driver.
        compiler: NVRTC's file; None if there is none for this driver.
        missing: Why training cannot use the device; None if it can.
    """

    name: str
    number: int
    capability: int
    is_integrated: bool
    limits: dict[str, int]
    driver: Driver
    compiler: Path | None
    missing: str | None


def cuda_devices() -> list[CudaDevice]:
    """Return the devices of NVIDIA's driver; none without the driver."""
    try:
        driver = Driver()
        return [
            describe_device(driver, number, find_compilers()) for number in range(driver.integer("cuDeviceGetCount"))
        ]
    except GpuError:
        return []


def describe_device(driver: Driver, number: int, compilers: Sequence[Path]) -> CudaDevice:
    """Return what the driver knows of a device.

    Args:
        driver: Driver.
        number: Number of the device.
        compilers: Files of NVRTC, the newest first.

    Raises:
        GpuError: The driver reports an error.
    """

    def attribute(which: int) -> int:
        return driver.integer("cuDeviceGetAttribute", which, device)

    device = driver.integer("cuDeviceGet", number)
    name, memory = ctypes.create_string_buffer(256), ctypes.c_size_t()
    driver.call("cuDeviceGetName", name, len(name), device)
    driver.call("cuDeviceTotalMem_v2", ctypes.byref(memory), device)
    capability = 10 * attribute(MAJOR) + attribute(MINOR)
    compiler, missing = _choose_compiler(compilers, driver.integer("cuDriverGetVersion") // 1000)
    if capability < LEAST_CAPABILITY:
        missing = f"its compute capability is {capability / 10:.1f}, training needs {LEAST_CAPABILITY / 10:.1f}"
    limits = {
        "max-compute-invocations-per-workgroup": attribute(THREADS),
        "max-compute-workgroup-storage-size": attribute(SHARED_MEMORY),
        "max-storage-buffers-per-shader-stage": BUFFERS,
        "max-storage-buffer-binding-size": memory.value,
    }
    integrated = bool(attribute(IS_INTEGRATED))
    return CudaDevice(name.value.decode(), device, capability, integrated, limits, driver, compiler, missing)


def _choose_compiler(found: Sequence[Path], version: int) -> tuple[Path | None, str | None]:
    """Return the compiler for a driver, and why there is none. version: major version of CUDA that the driver supports."""
    fitting = [path for path in found if compiler_version(path) <= version]
    if fitting:
        return fitting[0], None
    package = "nvidia-cuda-nvrtc" if version >= 13 else "nvidia-cuda-nvrtc-cu12"
    what = "NVRTC is not installed" if not found else f"NVRTC {compiler_version(found[-1])} needs a newer driver"
    return None, f"{what} (pip install {package})"
