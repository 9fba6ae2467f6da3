"""An emulated NVIDIA GPU for tests: the host program calls a driver and a compiler that run kernels on the CPU (g++ is needed)."""

import atexit
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import pytest

from splatreel.gpu.adapters import CUDA, Adapter
from splatreel.gpu.cuda_libraries import CudaDevice, Driver, describe_device

SOURCES = Path(__file__).with_name("emulator")


@cache
def emulated_libraries() -> Path:
    """Compile the driver and the compiler, which are one library, and return its file."""
    if shutil.which("g++") is None or os.uname().machine not in ("x86_64", "aarch64"):
        pytest.skip("the emulated GPU needs g++")
    folder = Path(tempfile.mkdtemp(prefix="emulated-gpu-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ["EMULATOR_FOLDER"] = str(folder)
    os.environ["XDG_CACHE_HOME"] = str(folder / "cache")  # of compiled kernels
    file = folder / "libnvrtc.so.12"
    command = ["g++", "-std=c++17", "-O1", "-fPIC", "-shared", f'-DEMULATOR_HEADERS="{SOURCES}"']
    subprocess.run([*command, str(SOURCES / "libraries.cpp"), "-o", str(file), "-ldl"], check=True)
    return file


@cache
def emulated_device() -> CudaDevice:
    file = emulated_libraries()
    return describe_device(Driver(file), 0, [file])


def emulated_adapter() -> Adapter:
    device = emulated_device()
    return Adapter(device.name, CUDA, "DiscreteGPU", device.limits, True, device)
