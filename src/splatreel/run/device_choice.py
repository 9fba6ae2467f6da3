"""Choice of the device that trains, and a check that the images of a group fit on it."""

from __future__ import annotations

import importlib.util
import math

import torch

from splatreel.base.command_line import install_command
from splatreel.base.errors import MissingDependencyError, ReconstructionError, UsageError
from splatreel.gpu.adapters import adapters, choose_adapter, require_adapter
from splatreel.gpu.shared_gpu import SharedGpu

IMAGES_SHARE = 0.6
"""Largest share of the GPU's free memory that images may take. Training needs the rest."""


NAMES = ("auto", "cpu", "gpu", "cuda")
"""Values of `--device`."""


def pick_device(name: str) -> torch.device:
    """Return the device of the tensors. With `pick_gpu`, the tensors are on the CPU, and the GPU runs whole iterations.

    Args:
        name: cpu, cuda (with gsplat), gpu (through wgpu or NVRTC), or auto: CUDA if there is an NVIDIA GPU and gsplat is installed,
            else the CPU.

    Raises:
        UsageError: The device does not exist.
        MissingDependencyError: gsplat is not installed.
    """
    if name not in NAMES:
        raise UsageError(f"Unknown device {name!r}. Choose auto, cpu, gpu or cuda.")
    # PyTorch for AMD's ROCm also calls its devices cuda. gsplat cannot use them.
    cuda = torch.cuda.is_available() and torch.version.hip is None
    gsplat = importlib.util.find_spec("gsplat") is not None
    if name == "cuda" and not cuda:
        raise UsageError("--device cuda: PyTorch finds no CUDA device. Use --device cpu, or install PyTorch for CUDA.")
    if name == "cuda" and not gsplat:
        raise MissingDependencyError(
            f"--device cuda: gsplat is not installed. Run `{install_command('cuda')}`, or use --device gpu, "
            "which needs no compiler."
        )
    return torch.device("cuda" if name in ("auto", "cuda") and cuda and gsplat else "cpu")


def pick_gpu(name: str, bytes_of_buffer: int = 0) -> tuple[SharedGpu | None, str]:
    """Return the GPU that trains through wgpu or NVRTC, if any, and a note for the user: why a GPU of this machine is not used.

    Args:
        name: See `pick_device`. `auto` takes a GPU that CUDA does not take, but no software adapter.
        bytes_of_buffer: Bytes of the largest buffer that training needs.

    Raises:
        UsageError: There is no GPU, or it is too small, and `name` is gpu.
    """
    if name == "gpu":
        adapter = require_adapter()
    elif name != "auto" or pick_device(name).type == "cuda":
        return None, ""
    else:
        found = adapters()
        adapter, why = choose_adapter(found)
        if adapter is None:
            hardware = any(not each.is_software for each in found)
            return None, f"training runs on the CPU: {why}" if hardware else ""
    largest = adapter.limits["max-storage-buffer-binding-size"]
    if bytes_of_buffer > largest:
        room = (
            f"{adapter.name} allows buffers of {largest / 1e6:,.0f} MB, training needs {bytes_of_buffer / 1e6:,.0f} MB"
        )
        if name == "gpu":
            raise UsageError(f"--device gpu: {room}. Use --device cpu, or ask for a smaller --width.")
        return None, f"training runs on the CPU: {room}"
    return SharedGpu(adapter), ""


def largest_buffer(width: int, height: int, points: int) -> int:
    """Return the bytes of the largest buffer on a GPU, as far as it is known before training.

    Args:
        width: Width of the images, pixels.
        height: Height of the images, pixels.
        points: Maximum number of points of the first keyframe.
    """
    return max(16 * width * height, 4 * 59 * points)


def check_room(needed: int, free: int, width: int) -> None:
    """Check that images fit into the memory of a GPU.

    Args:
        needed: Bytes of the images.
        free: Free bytes of the GPU.
        width: Width of the images in pixels, for the error.

    Raises:
        ReconstructionError: They do not fit. The error names a width that fits.
    """
    if needed > IMAGES_SHARE * free:
        fits = int(width * math.sqrt(IMAGES_SHARE * free / needed)) // 2 * 2
        raise ReconstructionError(
            f"The images of one group, {width} pixels wide, take {needed / 1e9:.1f} GB; the GPU has {free / 1e9:.1f} GB free, "
            f"of which they may fill {IMAGES_SHARE:.0%}. Ask for --width {fits}, or use --device cpu."
        )
