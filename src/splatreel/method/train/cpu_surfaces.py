"""Gradients of the losses of surfaces (`regularizers.spread` and `regularizers.roughness`) to an image of depths, as arrays."""

from __future__ import annotations

import numpy as np

from splatreel.method.train.regularizers import EDGE_CONTRAST, MAX_SEPARATION, MIN_ALPHA, MIN_VARIANCE


def depth_powers(depths: np.ndarray, near: float) -> np.ndarray:
    """Return the log depths over the near plane, their squares and their cubes, [N, 3], of depths [N]."""
    depth = np.log(np.maximum(depths, np.float32(near)) / np.float32(near))
    square = depth * depth
    return np.stack([depth, square, square * depth], 1)


def surface_gradients(
    sums: np.ndarray, alpha: np.ndarray, image: np.ndarray, spread: float, roughness: float, span: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradients to `sums` and `alpha` of both losses, see `Depths` for the way to them.

    Args:
        sums: [H, W, 3] blended `depth_powers`.
        alpha: [H, W] opacity.
        image: [H, W, 3] uint8 target.
        spread: Weight of `regularizers.spread`.
        roughness: Weight of `regularizers.roughness`.
        span: See `regularizers.roughness`.
    """
    shown = np.maximum(alpha, np.float32(MIN_ALPHA))
    first, second, third = (sums[..., k] / shown for k in range(3))
    d_first, d_second = np.zeros_like(first), np.zeros_like(first)
    if spread:
        d_first, d_second = _spread_gradients(first, second, third, alpha, spread)
    if roughness:
        d_first += _roughness_gradient(first, image, roughness, span)
    d_sums = np.stack([d_first / shown, d_second / shown, np.zeros_like(first)], -1)
    d_alpha = -(d_sums[..., 0] * first + d_sums[..., 1] * second) * (alpha >= np.float32(MIN_ALPHA))
    return d_sums, d_alpha


def _spread_gradients(
    first: np.ndarray, second: np.ndarray, third: np.ndarray, alpha: np.ndarray, weight: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradients [H, W] of `regularizers.spread` to the first and the second moment."""
    variance = np.maximum(second - first * first, np.float32(MIN_VARIANCE))
    deviation = np.sqrt(variance)
    skewness = (third - 3 * first * variance - first * first * first) / (variance * deviation)
    root = np.sqrt(skewness * skewness + 4)
    far = first + deviation * (skewness + root) / 2
    share = (root - skewness) / (2 * root)
    limit = np.minimum(np.float32(MAX_SEPARATION**2) / (variance * root * root), 1)
    d_second = alpha * share * share * limit * np.float32(weight / alpha.size)
    return -2 * far * d_second, d_second


def _roughness_gradient(first: np.ndarray, image: np.ndarray, weight: float, span: float) -> np.ndarray:
    """Return the gradient [H, W] of `regularizers.roughness` to the mean log depth."""
    inverse = np.float32(span) * np.exp(-first)
    d_inverse, colors = np.zeros_like(inverse), image.astype(np.int16)
    for swap in (False, True):
        depth, slopes, pixels = (each.swapaxes(0, 1) if swap else each for each in (inverse, d_inverse, colors))
        bend = depth[:-2] - 2 * depth[1:-1] + depth[2:]
        contrast = np.abs(pixels[2:] - pixels[:-2]).max(-1).astype(np.float32)
        slope = np.sign(bend) * np.exp(contrast * np.float32(-1 / (255 * EDGE_CONTRAST)))
        slope *= np.float32(weight / bend.size)
        slopes[:-2] += slope
        slopes[1:-1] -= 2 * slope
        slopes[2:] += slope
    return -inverse * d_inverse
