"""Training on a subject before few cameras: images over opposite backgrounds, and colors of points that views hardly see."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from splatreel.base.paged_arrays import frame_array
from splatreel.capture.masks import is_doubtful
from splatreel.kernels import splat
from splatreel.kernels.splat import Splats
from splatreel.method.train.dynamic_points import DynamicPoints
from splatreel.method.train.render import StaticCache, View, contributions, deformed
from splatreel.method.train.trainable_points import TrainablePoints
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import C0


def with_opposite(images: TrainingImages, alpha: np.ndarray) -> TrainingImages:
    """Return training images of a subject together with the same images over the opposite backgrounds.

    Each camera has one color behind its subject. A point that only this camera sees, beside the subject, can take that
    color, and is then a halo in novel views. Over the color and its opposite in turn, only transparency is right. `alpha`
    [T, C, H, W] uint8 is the subject's opacity; pixels in doubt become unknown.
    """
    if (unknown := is_doubtful(alpha)).any():
        images = replace(images, unknown=unknown if images.unknown is None else unknown | images.unknown)
    pixels, views = images.pixels, [opposite_view(view) for view in images.views]
    changes = [_change(view) for view in images.views]
    other = frame_array(pixels.shape)
    for frame, opacity in enumerate(alpha):
        for camera, change in enumerate(changes):
            behind = 1 - opacity[camera] / np.float32(255)
            color = pixels[frame, camera] + behind[..., None] * change
            other[frame, camera] = color.round().clip(0, 255)
    return replace(images, opposite=replace(images, pixels=other, views=views, array=other))


def opposite_view(view: View) -> View:
    """Return a view with the opposite color behind all points."""
    gain = np.ones(3, np.float32) if view.gain is None else view.gain
    return replace(view, background=(1 - _behind(view)) / gain)


def _behind(view: View) -> np.ndarray:
    """Return the color [3] behind the subject in the images of a view, 0..1."""
    if view.background is None:
        return np.zeros(3, np.float32)
    return view.background if view.gain is None else view.background * view.gain


def _change(view: View) -> np.ndarray:
    """Return the difference [3] of the opposite background and the background of a view, 0..255."""
    return 255 * (1 - 2 * _behind(view))


SEEN = 0.3
"""Share of a point's broad side that a view must show for its color to count in full."""
NEIGHBORS, PASSES = 12, 4
"""Number of nearest points that a color is taken from, and of passes by which colors spread."""
LEAST = 1e-4
"""Weight of a point that no view shows, as a share of one that a view shows."""


def spread_colors(points: TrainablePoints, seen: np.ndarray) -> None:
    """Give points that no view shows well the mean color of their neighbors. It depends on the view as little as they are seen.

    Few cameras leave much of a surface unseen, or see it along its edge. The color of a point there fits a few mixed
    pixels, and a novel view shows it at full size. `seen` [N] are the shares of the points that views show (`seen_shares`).
    """
    count = min(NEIGHBORS + 1, len(points) - 1)
    if count < 1:
        return
    params = points.params
    own = np.square((seen / SEEN).clip(0, 1))
    index, distance = splat.nearest_neighbors(points.means, count)
    closeness = 1 / (distance + max(np.quantile(distance[:, 0], 0.5, method="lower"), np.float32(1e-9)))
    base = params["sh_base"][:, 0].copy()
    known, color = own, base
    for _ in range(PASSES):
        weight = (known[index] + LEAST) * closeness
        around = (weight[..., None] * color[index]).sum(1) / weight.sum(1, keepdims=True)
        color = own[:, None] * base + (1 - own[:, None]) * around
        known = np.maximum(own, known[index].mean(1) / 2)
    params["sh_base"][:, 0] = color
    params["sh_rest"] *= own[:, None, None]


def seen_shares(
    points: TrainablePoints,
    images: TrainingImages,
    static: StaticCache | None,
    project: Callable[[View], Splats] | None = None,
) -> np.ndarray:
    """Return how much of each point's broad side is shown, [N]: the largest share over the views, 0..1.

    `project` projects the points into a view; None projects them where they are.
    """
    _, middle, broad = np.sort(points.scales, 1).T
    found = np.zeros_like(middle)
    for camera, view in enumerate(images.views):
        splats = project(view) if project else deformed(points.params, None, None, view, images.near)
        shown = contributions(splats, view, None if static is None else static.view(camera))
        size = view.K[0, 0] / np.maximum(splats.depths, images.near)
        area = 2 * math.pi * np.sqrt(np.square(middle * size) + 0.1) * np.sqrt(np.square(broad * size) + 0.1)
        found = np.maximum(found, shown / np.maximum(points.opacities * area, 1e-6))
    return np.minimum(found, 1)


MOST_FRAMES = 8
"""Largest number of frames, spread over a group, that are searched for views that show a point."""


def spread_colors_of_group(points: DynamicPoints, images: TrainingImages, static: StaticCache) -> None:
    """Spread colors to the points of a group that no view shows well at any frame (`spread_colors`).

    The motion of a group is trained long after its keyframe. Colors that no view shows well change meanwhile.
    """
    seen = np.zeros(len(points), np.float32)
    for frame in np.unique(np.linspace(0, images.count - 1, MOST_FRAMES).round().astype(int)).tolist():
        changes = points.changes(frame)
        project = partial(points.splats, changes, near=images.near)
        seen = np.maximum(seen, seen_shares(points.canonical, images, static, project))
    spread_colors(points.canonical, seen)


def bound_colors(points: TrainablePoints) -> None:
    """Keep the constant part of all colors within 0..1."""
    base = points.params["sh_base"]
    np.clip(base, -0.5 / C0, 0.5 / C0, out=base)
