"""New points of a first keyframe in the pixels that differ most from the training images.

Gradients of positions are small where a detail is missing altogether, such as a dot on a plain wall. Errors show it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np

from splatreel.kernels.splat import Splats
from splatreel.method.train.ray_depths import RayDepths
from splatreel.method.train.render import View
from splatreel.method.train.terms.depths import Depths
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import C0

ADDED_AT = (0.3, 0.4, 0.5, 0.6)
"""Shares of training after which points are added."""
ADDED_SHARE = 0.2
"""Points added at each of these times, as a share of all points."""
SIZE = 0.7
"""Standard deviation of an added point, pixels."""
OPACITY = 0.3
"""Opacity of an added point."""
MIN_ALPHA = 0.5
"""Alpha above which a pixel has a depth."""

Draw = Callable[[int], tuple[Splats, np.ndarray]]
"""Function that returns the projected points of a camera and the image [H, W, 3] that the camera would take of them."""


def adds_after(done: int, total: int) -> bool:
    """Return whether points are added after `done` iterations of `total`."""
    return done in [round(at * total) for at in ADDED_AT]


def points_at_errors(
    draw: Draw, images: TrainingImages, gains: np.ndarray, bands: int, count: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Return new points in random pixels. The probability of a pixel is its absolute error times its loss of similarity (1 - SSIM).

    A point takes the color of its pixel, and the depth that neighboring views agree on (`RayDepths`), else the rendered depth.

    Args:
        draw: Draws the current points.
        images: Training images.
        gains: [C, 3] color gains of the cameras.
        bands: Number of harmonics of a point beyond the constant.
        count: Number of points to add, over all cameras.
        rng: Source of the pixels.

    Returns:
        Unconstrained arrays of up to `count` points, as in `TrainablePoints`.
    """
    found, ray_depths = [], RayDepths(images)
    for camera, view in enumerate(images.views):
        splats, image = draw(camera)
        target = images.target(0, camera, image, None).astype(np.float32) / 255
        depths = Depths.of(splats, view, images.near)
        known, rendered = depths.alpha > MIN_ALPHA, images.near * np.exp(depths.moments[..., 0])
        pixels = _choose(_errors(image, target) * known, count // len(images.views), rng)
        depth = ray_depths.agreed(camera, pixels, rendered, known).astype(np.float32)
        found.append((*_unproject(view, pixels, depth), target.reshape(-1, 3)[pixels] / gains[camera]))
    means, sizes, colors = (np.concatenate(column) for column in zip(*found, strict=True))
    added = len(means)
    return {
        "means": means,
        "quats": np.tile(np.array([1, 0, 0, 0], np.float32), (added, 1)),
        "log_scales": np.tile(np.log(sizes)[:, None], (1, 3)),
        "logit_opacities": np.full(added, math.log(OPACITY / (1 - OPACITY)), np.float32),
        "sh_base": ((colors - 0.5) / C0)[:, None],
        "sh_rest": np.zeros((added, bands, 3), np.float32),
    }


def _errors(image: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the absolute error times the loss of similarity (1 - SSIM) at every pixel [H, W] of images [H, W, 3], 0..1."""
    first, second = (_blurred(x) for x in (image, target))
    variances = _blurred(image * image) - first * first, _blurred(target * target) - second * second
    covariance = _blurred(image * target) - first * second
    c1, c2 = 0.01**2, 0.03**2
    similarity = (2 * first * second + c1) * (2 * covariance + c2)
    similarity /= (first * first + second * second + c1) * (variances[0] + variances[1] + c2)
    return np.abs(image - target).mean(-1) * np.clip(1 - similarity, 0, 1).mean(-1)


def _blurred(image: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(image, (11, 11), 1.5)


def _choose(weights: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return up to `count` different pixels [M] int64 of an image of weights [H, W], each with a probability by its weight."""
    flat = weights.astype(np.float64).ravel()
    count = min(count, int((flat > 0).sum()))
    return rng.choice(len(flat), count, replace=False, p=flat / flat.sum()) if count else np.zeros(0, np.int64)


def _unproject(view: View, pixels: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions [M, 3] of pixels [M] at depths [M], and the sizes [M] there, world units."""
    row, column = pixels // view.width, pixels % view.width
    x = (column + 0.5 - view.K[0, 2]) / view.K[0, 0] * depth
    y = (row + 0.5 - view.K[1, 2]) / view.K[1, 1] * depth
    local = np.stack([x, y, depth], 1).astype(np.float32)
    return (local - view.viewmat[:3, 3]) @ view.viewmat[:3, :3], SIZE * depth / view.K[0, 0]
