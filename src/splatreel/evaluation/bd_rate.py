"""Bjontegaard's delta rate: how many more bytes one codec takes than another at the same quality, over all qualities both reach."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator

Curve = Sequence[tuple[float, float]]
"""(bytes, PSNR in dB) of one codec at several settings."""


def bd_rate(anchor: Curve, test: Curve) -> float | None:
    """Mean difference of bytes at equal PSNR, as a share of the anchor's: -0.3 is 30 % fewer.

    Logarithms of bytes are interpolated over PSNR by monotone cubics, through those settings that no other one beats in both.
    None where fewer than two of them are left, or the curves have no quality in common.
    """
    curves = [_front(curve) for curve in (anchor, test)]
    if min(len(curve) for curve in curves) < 2:
        return None
    low = max(curve[0, 1] for curve in curves)
    high = min(curve[-1, 1] for curve in curves)
    if not low < high:
        return None
    means = [PchipInterpolator(c[:, 1], np.log(c[:, 0])).integrate(low, high) / (high - low) for c in curves]
    return float(np.exp(means[1] - means[0]) - 1)


def _front(curve: Curve) -> np.ndarray:
    """[K, 2] (bytes, PSNR) with rising PSNR of the settings that are best for their bytes."""
    best: list[tuple[float, float]] = []
    for size, quality in sorted(curve):
        if not best or quality > best[-1][1]:
            best.append((size, quality))
    return np.array(best).reshape(-1, 2)
