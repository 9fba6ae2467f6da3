"""The host program of NVIDIA GPUs, on an emulated driver: memory, launches, errors, and the choice of a compiler."""

import ctypes
import gc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import GpuError
from splatreel.gpu import adapters as adapters_module
from splatreel.gpu import cuda_device, cuda_libraries, self_test
from splatreel.gpu.adapters import adapters, choose_adapter
from splatreel.gpu.cuda_device import CudaGpu
from splatreel.gpu.cuda_libraries import Compiler, Driver, describe_device
from splatreel.gpu.device import Gpu
from splatreel.gpu.shared_gpu import open_gpu
from tests.gpu.devices import emulated_gpu
from tests.gpu.emulated import emulated_adapter, emulated_device, emulated_libraries

ALL = 4
"""Orders in which the emulator runs the threads of a block: forwards, backwards, one warp ahead, random, or all in turn."""


@pytest.fixture
def library() -> Iterator[ctypes.CDLL]:
    found = ctypes.CDLL(str(emulated_libraries()))
    found.emulatorSetFreeBytes.argtypes = (ctypes.c_size_t,)
    yield found
    found.emulatorFail(b"")
    found.emulatorSetFreeBytes(1 << 32)
    found.emulatorSetOrder(ALL)


def test_buffers_are_zero_hold_what_is_written_and_are_freed(library: ctypes.CDLL) -> None:
    gpu = emulated_gpu()
    gc.collect()
    before = library.emulatorCountBuffers()
    buffer = gpu.zeros(100)
    assert buffer.size == 128
    gpu.write(buffer, np.arange(5, dtype=np.uint16), 4)
    np.testing.assert_array_equal(gpu.read(buffer, np.uint16, (4, 2)), [[0, 0], [0, 1], [2, 3], [4, 0]])
    assert gpu.read(buffer, np.float32, (0, 3)).shape == (0, 3)
    assert library.emulatorCountBuffers() == before + 1
    del buffer
    gc.collect()
    assert library.emulatorCountBuffers() == before
    with pytest.raises(GpuError, match="8 bytes do not fit at 60 of 64"):
        gpu.write(gpu.zeros(4), np.zeros(2, np.float32), 60)


def test_work_runs_when_it_is_submitted_in_order() -> None:
    """All work of a list sees what is written before `submit`, as in WebGPU."""
    gpu = emulated_gpu()
    values, length = gpu.upload(np.ones(256, np.uint32)), gpu.uniform(np.zeros(4, np.uint32))
    buffers = {"values": values, "sums": gpu.zeros(4), "length": length}
    recording = gpu.record()
    recording.clear(values, 0, 16)
    recording.run_each(gpu.kernel("scan_blocks"), 64, buffers)
    recording.run(gpu.kernel("scan_blocks"), (0, 1, 1), buffers)  # nothing
    gpu.write(length, np.array([256], np.uint32))
    gpu.write(length, np.array([1], np.uint32), 4)
    assert gpu.read(values, np.uint32, (256,)).tolist() == [1] * 256
    recording.submit()
    expected = np.maximum(np.arange(256) - 4, 0)
    np.testing.assert_array_equal(gpu.read(values, np.uint32, (256,)), expected)
    assert gpu.read(buffers["sums"], np.uint32, (1,))[0] == 252


def test_missing_memory_and_a_lost_device_are_errors(library: ctypes.CDLL) -> None:
    gpu = emulated_gpu()
    with pytest.raises(GpuError, match="the images takes 5,000 MB, and a buffer may have 4,295 MB"):
        gpu.zeros(5_000_000_000, "the images")
    library.emulatorSetFreeBytes(1 << 20)
    with pytest.raises(GpuError, match=r"emulated GPU: no room for the images of 2 MB: .*out of memory"):
        gpu.zeros(2_000_000, "the images")
    buffer = gpu.zeros(64)
    library.emulatorFail(b"unspecified launch failure")
    with pytest.raises(GpuError, match=r"emulated GPU: the device was lost: .*unspecified launch failure"):
        gpu.read(buffer, np.uint32, (1,))
    with pytest.raises(GpuError, match="the device was lost"):
        gpu.write(buffer, np.zeros(1, np.uint32))


def test_the_emulator_finds_accesses_outside_of_a_buffer(library: ctypes.CDLL) -> None:
    gpu = emulated_gpu()
    buffers = {"values": gpu.zeros(4), "sums": gpu.zeros(4), "length": gpu.uniform(np.array([999, 1, 0, 0], np.uint32))}
    recording = gpu.record()
    recording.run_each(gpu.kernel("scan_blocks"), 64, buffers)
    recording.submit()
    with pytest.raises(GpuError, match="outside of a buffer"):
        gpu.read(buffers["sums"], np.uint32, (1,))


def test_a_kernel_that_does_not_compile_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_device, "translate", lambda source: "nonsense")
    with pytest.raises(GpuError, match=r"Kernel scan_blocks does not compile(.|\n)*nonsense"):
        CudaGpu(emulated_adapter()).kernel("scan_blocks")


def test_compiled_kernels_are_kept_on_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second process loads a kernel without the compiler. Another source, option or compiler is compiled."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compiled = []
    original = Compiler._compile

    def compile_(self: Compiler, source: str, *rest: Any) -> bytes:
        compiled.append(source)
        return original(self, source, *rest)

    monkeypatch.setattr(Compiler, "_compile", compile_)
    for _ in range(2):
        CudaGpu(emulated_adapter()).kernel("scan_add")
    assert len(compiled) == 1
    CudaGpu(emulated_adapter(), group=128).kernel("scan_add")
    assert len(compiled) == 2
    assert len(list((tmp_path / "splatreel" / "nvrtc").iterdir())) == 2


def test_kernels_are_compiled_where_nothing_can_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "splatreel").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert CudaGpu(emulated_adapter()).kernel("scan_add").program


def test_the_adapter_is_found_and_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    device = emulated_device()
    monkeypatch.setattr(adapters_module, "cuda_devices", lambda: [device])
    monkeypatch.setattr(adapters_module, "is_installed", lambda: False)
    adapters.cache_clear()
    try:
        chosen, why = choose_adapter(adapters())
    finally:
        adapters.cache_clear()
    assert why == "emulated GPU through CUDA and NVRTC."
    assert chosen is not None
    tested: list[Gpu] = []
    monkeypatch.setattr(self_test, "check_device", tested.append)  # test_self_test.py tests it
    assert tested == [open_gpu(chosen)]
    assert isinstance(tested[0], CudaGpu)


@pytest.mark.parametrize(
    ("files", "chosen", "missing"),
    [
        (["libnvrtc.so.13", "libnvrtc.so.12"], "libnvrtc.so.12", None),  # the emulated driver is of CUDA 12
        (["nvrtc64_120_0.dll"], "nvrtc64_120_0.dll", None),
        (["libnvrtc.so.13"], None, "NVRTC 13 needs a newer driver (pip install nvidia-cuda-nvrtc-cu12)"),
        ([], None, "NVRTC is not installed (pip install nvidia-cuda-nvrtc-cu12)"),
    ],
)
def test_the_newest_compiler_that_fits_the_driver_is_used(
    files: list[str], chosen: str | None, missing: str | None, tmp_path: Path
) -> None:
    for name in files:
        (tmp_path / name).symlink_to(emulated_libraries())
    device = describe_device(Driver(emulated_libraries()), 0, [tmp_path / name for name in files])
    assert (device.compiler and device.compiler.name, device.missing) == (chosen, missing)
    assert (device.name, device.capability, device.is_integrated) == ("emulated GPU", 90, False)


def test_a_device_that_the_newest_compiler_has_dropped_gets_an_older_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A V100 (7.0) with a driver of CUDA 13, whose compiler starts at 7.5."""

    class Known:
        def __init__(self, file: Path) -> None:
            if file.parent != tmp_path:
                raise GpuError(f"{file} cannot be loaded")
            self.supported = [75, 120] if "13" in file.name else [50, 90]

    monkeypatch.setattr(cuda_libraries, "Compiler", Known)
    new, old = tmp_path / "libnvrtc.so.13", tmp_path / "libnvrtc.so.12"
    choose = cuda_libraries._choose_compiler
    assert choose([new, old], 13, 70) == (old, None)
    assert choose([new, old], 13, 75) == (new, None)
    assert choose([Path("libnvrtc.so.13"), old], 13, 90) == (old, None)
    missing = (
        "NVRTC 13 does not load, or no longer compiles for compute capability 7.0 (pip install nvidia-cuda-nvrtc-cu12)"
    )
    assert choose([new], 13, 70) == (None, missing)


def test_without_a_driver_there_is_no_device(tmp_path: Path) -> None:
    with pytest.raises(GpuError, match=r"libcuda.so.1 cannot be loaded"):
        Driver(tmp_path / "libcuda.so.1")
