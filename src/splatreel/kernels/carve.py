"""Space carving: how well views agree on the color of places in space. A numba kernel on the CPU."""

from __future__ import annotations

import numpy as np

from splatreel.kernels.cpu import carve as kernel
from splatreel.kernels.cpu.scalars import F, finite


def disagreement(
    places: np.ndarray,
    own: np.ndarray,
    viewmats: np.ndarray,
    Ks: np.ndarray,
    images: np.ndarray,
    wrong: np.ndarray,
    depths: np.ndarray,
    near: float,
    least: float,
    share: float,
) -> np.ndarray:
    """[R, D] mean color difference, 0..1, of places to their ray's own color, over the views whose masks hold them.

    Infinite where fewer than `least` masks hold a place, or less than `share` of those of the views that see it: it is in their
    pictures, and nothing known is before it. places: [R, D, 3] world. own: [R, 3] 0..1. viewmats: [C, 4, 4]; Ks: [C, 3, 3]. images:
    [C, H, W, 3] uint8; wrong: [C, H, W] bool, the masks; depths: [C, H, W] of what is known, infinite for nothing.
    """
    out = np.full(places.shape[:2], np.inf, np.float32)
    places, own, viewmats, Ks = (np.ascontiguousarray(array, np.float32) for array in (places, own, viewmats, Ks))
    limits = F(near), F(least), F(share)
    kernel.disagreement.over(len(out), places, own, viewmats, Ks, images, wrong, finite(depths), *limits, out, grain=16)
    return out
