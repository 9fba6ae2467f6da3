"""NVIDIA's driver, its devices and its run-time compiler (NVRTC), through ctypes. Neither the CUDA toolkit nor torch is needed."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib.util
import re
import sys
from collections.abc import Iterator, Sequence
from ctypes import POINTER, byref, c_char_p, c_int, c_size_t, c_ubyte, c_uint, c_uint64, c_void_p
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatreel.base import user_cache
from splatreel.base.errors import GpuError

DRIVER = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
"""File of the driver, which the system finds."""
COMPILER = re.compile(r"libnvrtc\.so\.(\d+)|nvrtc64_(\d+)\d_\d\.dll")
"""Names of the compiler's file, with its major version."""
_DRIVER_CALLS: dict[str, tuple[Any, ...]] = {
    "cuInit": (c_uint,),
    "cuDriverGetVersion": (POINTER(c_int),),
    "cuDeviceGetCount": (POINTER(c_int),),
    "cuDeviceGet": (POINTER(c_int), c_int),
    "cuDeviceGetName": (c_char_p, c_int, c_int),
    "cuDeviceGetAttribute": (POINTER(c_int), c_int, c_int),
    "cuDeviceTotalMem_v2": (POINTER(c_size_t), c_int),
    "cuDevicePrimaryCtxRetain": (POINTER(c_void_p), c_int),
    "cuCtxSetCurrent": (c_void_p,),
    "cuModuleLoadData": (POINTER(c_void_p), c_char_p),
    "cuModuleGetFunction": (POINTER(c_void_p), c_void_p, c_char_p),
    "cuMemAlloc_v2": (POINTER(c_uint64), c_size_t),
    "cuMemFree_v2": (c_uint64,),
    "cuMemsetD8_v2": (c_uint64, c_ubyte, c_size_t),
    "cuMemsetD8Async": (c_uint64, c_ubyte, c_size_t, c_void_p),
    "cuMemcpyHtoD_v2": (c_uint64, c_void_p, c_size_t),
    "cuMemcpyDtoH_v2": (c_void_p, c_uint64, c_size_t),
    "cuLaunchKernel": (c_void_p, *7 * (c_uint,), c_void_p, c_void_p, c_void_p),
    "cuGetErrorString": (c_int, POINTER(c_char_p)),
}
_COMPILER_CALLS: dict[str, tuple[Any, ...]] = {
    "nvrtcCreateProgram": (POINTER(c_void_p), c_char_p, c_char_p, c_int, c_void_p, c_void_p),
    "nvrtcDestroyProgram": (POINTER(c_void_p),),
    "nvrtcCompileProgram": (c_void_p, c_int, POINTER(c_char_p)),
    "nvrtcGetProgramLogSize": (c_void_p, POINTER(c_size_t)),
    "nvrtcGetProgramLog": (c_void_p, c_char_p),
    "nvrtcGetCUBINSize": (c_void_p, POINTER(c_size_t)),
    "nvrtcGetCUBIN": (c_void_p, c_char_p),
    "nvrtcGetPTXSize": (c_void_p, POINTER(c_size_t)),
    "nvrtcGetPTX": (c_void_p, c_char_p),
    "nvrtcGetNumSupportedArchs": (POINTER(c_int),),
    "nvrtcGetSupportedArchs": (POINTER(c_int),),
}


class Driver:
    """NVIDIA's driver."""

    def __init__(self, file: str | Path = DRIVER) -> None:
        """Load the driver. Raise a `GpuError` if there is none, or it finds no device."""
        self._library = _load(file, _DRIVER_CALLS)
        self.call("cuInit", 0)

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the driver. Its errors are `GpuError`, also those of earlier work on the device."""
        code = getattr(self._library, name)(*arguments)
        if code:
            text = c_char_p()
            self._library.cuGetErrorString(code, byref(text))
            raise GpuError(f"{name}: error {code}, {(text.value or b'unknown').decode()}")

    def integer(self, name: str, *arguments: Any) -> int:
        """Call a function whose first argument receives an integer, and return the integer."""
        value = c_int()
        self.call(name, byref(value), *arguments)
        return value.value

    def pointer(self, name: str, *arguments: Any) -> int:
        """Call a function whose first argument receives a pointer, and return the address."""
        value = c_void_p()
        self.call(name, byref(value), *arguments)
        return value.value or 0


class Compiler:
    """NVIDIA's run-time compiler. `supported` are the compute capabilities that it compiles for, such as 90, in ascending order."""

    def __init__(self, file: Path) -> None:
        """Load the compiler, or raise a `GpuError`."""
        self._library = _load(file, _COMPILER_CALLS)
        self._file = file
        count = c_int()
        self._library.nvrtcGetNumSupportedArchs(byref(count))
        found = (c_int * count.value)()
        self._library.nvrtcGetSupportedArchs(found)
        self.supported = sorted(found)

    def compile(self, source: str, name: str, capability: int) -> bytes:
        """Compile CUDA C++ for a compute capability, such as 90. Return machine code, or PTX for newer devices.

        Results are kept in the user's cache, since each process needs them and compiling takes five seconds.
        Raise a `GpuError` if the source has an error.
        """
        known = max(each for each in self.supported if each <= capability)
        exact = known == capability
        options = [f"--gpu-architecture={'sm' if exact else 'compute'}_{known}".encode(), b"--std=c++17"]
        cached = self._cache_name(source, options)
        binary = user_cache.load(cached)
        if binary is None:
            binary = self._compile(source, name, options, exact)
            user_cache.save(cached, binary)
        return binary

    def _cache_name(self, source: str, options: Sequence[bytes]) -> str:
        found = self._file.stat()
        compiler = f"{self._file} {found.st_size} {found.st_mtime_ns}".encode()
        return f"nvrtc/{hashlib.sha256(b' '.join([compiler, *options, source.encode()])).hexdigest()}"

    def _compile(self, source: str, name: str, options: Sequence[bytes], exact: bool) -> bytes:
        program = c_void_p()
        self._library.nvrtcCreateProgram(byref(program), source.encode(), f"{name}.cu".encode(), 0, None, None)
        try:
            if self._library.nvrtcCompileProgram(program, len(options), (c_char_p * len(options))(*options)):
                log = self._result(program, "nvrtcGetProgramLog").decode(errors="replace")
                raise GpuError(f"Kernel {name} does not compile: {log[:2000]}")
            return self._result(program, "nvrtcGetCUBIN" if exact else "nvrtcGetPTX")
        finally:
            self._library.nvrtcDestroyProgram(byref(program))

    def _result(self, program: c_void_p, name: str) -> bytes:
        size = c_size_t()
        getattr(self._library, f"{name}Size")(program, byref(size))
        buffer = ctypes.create_string_buffer(size.value)
        getattr(self._library, name)(program, buffer)
        return buffer.raw


def find_compilers() -> list[Path]:
    """Return the compilers of the package nvidia-cuda-nvrtc, which torch for CUDA brings, or of torch itself; the newest first."""
    found = [path for folder in _folders() for path in folder.rglob("*nvrtc*") if COMPILER.fullmatch(path.name)]
    return sorted(found, key=lambda path: -compiler_version(path))


def compiler_version(path: Path) -> int:
    """Return the major version of CUDA that a compiler belongs to."""
    match = COMPILER.fullmatch(path.name)
    assert match is not None
    return int(match[1] or match[2])


def _folders() -> Iterator[Path]:
    """Yield the folders that contain libraries of CUDA, without an import of their packages."""
    with contextlib.suppress(ImportError, ValueError):
        nvidia = importlib.util.find_spec("nvidia")
        yield from map(Path, (nvidia and nvidia.submodule_search_locations) or ())
        torch = importlib.util.find_spec("torch")
        yield from (Path(place) / "lib" for place in (torch and torch.submodule_search_locations) or ())


def _load(file: str | Path, calls: dict[str, tuple[Any, ...]]) -> Any:
    """Load a library, and declare its functions."""
    try:
        library = ctypes.WinDLL(str(file)) if sys.platform == "win32" else ctypes.CDLL(str(file))
        for name, types in calls.items():
            getattr(library, name).argtypes = types
            getattr(library, name).restype = c_int
    except (OSError, AttributeError) as error:
        raise GpuError(f"{file} cannot be loaded: {error}") from error
    return library


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
        capability: Compute capability, such as 90.
        is_integrated: The device shares the memory of the processor.
        limits: Limits by wgpu's names.
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
    """Return what the driver knows of a device. `compilers` are files of NVRTC, the newest first. Errors are `GpuError`."""

    def attribute(which: int) -> int:
        return driver.integer("cuDeviceGetAttribute", which, device)

    device = driver.integer("cuDeviceGet", number)
    name, memory = ctypes.create_string_buffer(256), ctypes.c_size_t()
    driver.call("cuDeviceGetName", name, len(name), device)
    driver.call("cuDeviceTotalMem_v2", ctypes.byref(memory), device)
    capability = 10 * attribute(MAJOR) + attribute(MINOR)
    compiler, missing = _choose_compiler(compilers, driver.integer("cuDriverGetVersion") // 1000, capability)
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


def _choose_compiler(found: Sequence[Path], version: int, capability: int) -> tuple[Path | None, str | None]:
    """Return the newest compiler that a driver accepts and that knows the device, and why there is none.

    Compilers drop old devices: CUDA 13 compiles for compute capability 7.5 and newer.

    Args:
        found: Files of compilers, the newest first.
        version: Major version of CUDA that the driver supports.
        capability: Compute capability of the device, such as 90.
    """
    fitting = [path for path in found if compiler_version(path) <= version]
    for path in fitting:
        with contextlib.suppress(GpuError):
            if Compiler(path).supported[0] <= capability:
                return path, None
    package = "nvidia-cuda-nvrtc" if version >= 13 and capability >= 75 else "nvidia-cuda-nvrtc-cu12"
    if not found:
        what = "NVRTC is not installed"
    elif not fitting:
        what = f"NVRTC {compiler_version(found[-1])} needs a newer driver"
    else:
        what = f"NVRTC {compiler_version(fitting[0])} does not load, or no longer compiles for compute capability {capability / 10:.1f}"
    return None, f"{what} (pip install {package})"
