"""LPIPS, if its package and weights are on this machine. Nothing is downloaded."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np

from splatreel.motion.pretrained import cached_weights

Distance = Callable[[np.ndarray, np.ndarray], float]

BACKBONE = "vgg16-397923af.pth"


def available() -> bool:
    """Return whether `load` can succeed: the package is installed and torch's cache holds torchvision's VGG-16 weights."""
    if importlib.util.find_spec("torch") is None or importlib.util.find_spec("lpips") is None:
        return False
    return cached_weights(BACKBONE).is_file()


def load() -> Distance | None:
    """Return LPIPS (VGG, as in 3DGS papers) as a function of two float images [H, W, 3] 0..1, or None if not `available`."""
    if not available():
        return None
    import torch

    lpips: Any = importlib.import_module("lpips")
    model = lpips.LPIPS(net="vgg", verbose=False).eval()

    def distance(image: np.ndarray, truth: np.ndarray) -> float:
        pair = [torch.from_numpy(x.astype(np.float32)).permute(2, 0, 1)[None] * 2 - 1 for x in (image, truth)]
        with torch.no_grad():
            return float(model(*pair))

    return distance
