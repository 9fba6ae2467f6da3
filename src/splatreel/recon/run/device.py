"""Where to train, and whether a group's pictures fit there."""

from __future__ import annotations

import importlib.util
import math

import torch

from splatreel.errors import MissingDependencyError, ReconstructionError, UsageError

PICTURES_SHARE = 0.6
"""Of the GPU's free memory, at most, for pictures: training needs the rest."""


def pick_device(name: str) -> torch.device:
    """CUDA if it is asked for, or left open and there with gsplat, else the CPU. Raises `UsageError` for a device that is not there."""
    if name not in ("auto", "cpu", "cuda"):
        raise UsageError(f"Unknown device {name!r}. Choose auto, cpu or cuda.")
    gpu, gsplat = torch.cuda.is_available(), importlib.util.find_spec("gsplat") is not None
    if name == "cuda" and not gpu:
        raise UsageError("--device cuda: PyTorch finds no CUDA device. Use --device cpu, or install PyTorch for CUDA.")
    if name == "cuda" and not gsplat:
        raise MissingDependencyError(
            "--device cuda: gsplat is not installed. Run `pip install 'splatreel[cuda]'`, or use --device cpu."
        )
    return torch.device("cuda" if name != "cpu" and gpu and gsplat else "cpu")


def check_room(needed: int, free: int, width: int) -> None:
    """Raises `ReconstructionError` where pictures of `needed` bytes and that width do not fit into `free` bytes of a GPU."""
    if needed > PICTURES_SHARE * free:
        fits = int(width * math.sqrt(PICTURES_SHARE * free / needed)) // 2 * 2
        raise ReconstructionError(
            f"The pictures of one group, {width} pixels wide, take {needed / 1e9:.1f} GB; the GPU has {free / 1e9:.1f} GB free, "
            f"of which they may fill {PICTURES_SHARE:.0%}. Ask for --width {fits}, or use --device cpu."
        )
