"""Choice of the device that trains: the CPU, any GPU through wgpu or NVRTC, or an NVIDIA GPU with gsplat."""

from __future__ import annotations

import importlib.util

from splatreel.base.command_line import install_command
from splatreel.base.errors import GpuError, MissingDependencyError, UsageError
from splatreel.gpu.adapters import Adapter, adapters, choose_adapter, may_have_gpu, require_adapter
from splatreel.gpu.cuda_libraries import cuda_devices
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.play.timeline import Draw

NAMES = ("auto", "cpu", "gpu", "cuda")
"""Values of `--device`."""


def pick_gpu(name: str, width: int = 320, height: int = 180, points: int = 0) -> tuple[SharedGpu | None, str]:
    """Return the GPU that trains, or None for the CPU, and a note for the user: how fast both are, or why a GPU cannot be used.

    Args:
        name: cpu, cuda (with gsplat), gpu (through wgpu or NVRTC), or auto: CUDA if there is an NVIDIA GPU and gsplat is installed,
            else the faster one of another GPU, but no software adapter, and the CPU.
        width: Width of the images, pixels.
        height: Height of the images, pixels.
        points: Maximum number of points of the first keyframe.

    Raises:
        UsageError: The device does not exist, or it is too small, and `name` is gpu.
        MissingDependencyError: gsplat is not installed, and `name` is cuda.
    """
    if name not in NAMES:
        raise UsageError(f"Unknown device {name!r}. Choose auto, cpu, gpu or cuda.")
    if name == "cpu" or (name == "auto" and not may_have_gpu()):
        return None, ""
    if name == "cuda":
        _require_cuda("--device cuda", "--device gpu, which needs no compiler")
    if name == "cuda" or (name == "auto" and uses_gsplat()):
        from splatreel.gsplat.device import shared_gpu

        return shared_gpu(), ""
    if name == "gpu":
        adapter = require_adapter()
    else:
        found = adapters()
        adapter, why = choose_adapter(found)
        if adapter is None:
            hardware = any(not each.is_software for each in found)
            return None, f"training runs on the CPU: {why}" if hardware else ""
    largest = adapter.limits["max-storage-buffer-binding-size"]
    # Bytes of the largest buffer, as far as it is known before training: an image or the points.
    needed = max(16 * width * height, 4 * 59 * points)
    if needed > largest:
        room = f"{adapter.name} allows buffers of {largest / 1e6:,.0f} MB, training needs {needed / 1e6:,.0f} MB"
        if name == "gpu":
            raise UsageError(f"--device gpu: {room}. Use --device cpu, or ask for a smaller --width.")
        return None, f"training runs on the CPU: {room}"
    return (SharedGpu(adapter), "") if name == "gpu" else faster_device(adapter, width * height / 1e6)


def uses_gsplat() -> bool:
    """Return whether `--device auto` takes CUDA with gsplat."""
    return _has_gsplat() and _why_no_cuda() is None


def faster_device(adapter: Adapter, megapixels: float, renew: bool = False) -> tuple[SharedGpu | None, str]:
    """Return an adapter if it trains faster than the CPU, else None, and a note that says so. Arguments are those of `device_times`."""
    from splatreel.run.machine_speed import device_times

    try:
        times = device_times(adapter, megapixels, renew)
    except GpuError as error:
        return None, f"training runs on the CPU: {str(error).rstrip('.')}"
    is_faster = times.gpu < times.cpu
    where = f"{adapter.name} through {adapter.route}" if is_faster else "the CPU"
    note = (
        f"training runs on {where}: an iteration takes {times.gpu:.1f} ms on the GPU and {times.cpu:.1f} ms on the CPU"
    )
    return SharedGpu(adapter) if is_faster else None, note


def cuda_renderer() -> Draw:
    """Return the function of gsplat that draws for playback.

    Raises:
        UsageError: There is no CUDA device.
        MissingDependencyError: gsplat is not installed.
    """
    _require_cuda("--renderer cuda", "--renderer cpu or webgl")
    from splatreel.gsplat.device import draw

    return draw


def _require_cuda(option: str, instead: str) -> None:
    """Raise an error that names an option and another one, unless gsplat can use a GPU."""
    if not _has_gsplat():
        raise MissingDependencyError(
            f"{option}: gsplat is not installed. Run `{install_command('cuda')}`, or use {instead}."
        )
    if why := _why_no_cuda():
        raise UsageError(f"{option}: {why}. Use {instead.split(',')[0]}, or install PyTorch for CUDA.")


def _has_gsplat() -> bool:
    """Return whether gsplat and torch are installed, without importing them, which takes seconds."""
    return all(importlib.util.find_spec(name) is not None for name in ("torch", "gsplat"))


def _why_no_cuda() -> str | None:
    """Return why gsplat, which is installed, finds no GPU; None if it finds one."""
    if not cuda_devices():
        return "NVIDIA's driver finds no device"
    import torch  # after the question that needs no seconds

    # PyTorch for AMD's ROCm also calls its devices cuda. gsplat cannot use them.
    there = torch.cuda.is_available() and torch.version.hip is None
    return None if there else "PyTorch finds no CUDA device"


def count_cuda_devices() -> int:
    """Return the number of GPUs that gsplat can use."""
    import torch

    return torch.cuda.device_count()


def release_cuda_memory() -> None:
    """Give memory that PyTorch keeps for this process back to the GPU."""
    import torch

    torch.cuda.empty_cache()
