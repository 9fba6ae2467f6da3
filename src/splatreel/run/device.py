"""Choice of the device that trains, and a check that the images of a group fit on it."""

from __future__ import annotations

import importlib.util
import math

import torch

from splatreel.base.command_line import install_command
from splatreel.base.errors import MissingDependencyError, ReconstructionError, UsageError

IMAGES_SHARE = 0.6
"""Largest share of the GPU's free memory that images may take. Training needs the rest."""


def pick_device(name: str) -> torch.device:
    """Return the device to train on.

    Args:
        name: cpu, cuda, or auto: CUDA if there is a GPU and gsplat is installed, else the CPU.

    Raises:
        UsageError: The device does not exist.
        MissingDependencyError: gsplat is not installed.
    """
    if name not in ("auto", "cpu", "cuda"):
        raise UsageError(f"Unknown device {name!r}. Choose auto, cpu or cuda.")
    # PyTorch for AMD's ROCm also calls its devices cuda. gsplat cannot use them.
    gpu = torch.cuda.is_available() and torch.version.hip is None
    gsplat = importlib.util.find_spec("gsplat") is not None
    if name == "cuda" and not gpu:
        raise UsageError("--device cuda: PyTorch finds no CUDA device. Use --device cpu, or install PyTorch for CUDA.")
    if name == "cuda" and not gsplat:
        raise MissingDependencyError(
            f"--device cuda: gsplat is not installed. Run `{install_command('cuda')}`, or use --device cpu."
        )
    return torch.device("cuda" if name != "cpu" and gpu and gsplat else "cpu")


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
