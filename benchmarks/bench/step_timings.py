"""Timings of training steps on the CPU, each alternating with the same step without an optimization."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.timing import Timing, medians_ms, on_one_thread, ratio
from splatreel.base import threads
from splatreel.kernels import deform, photometric, rasterize
from splatreel.kernels.binning import bin_splats
from splatreel.method.train.render import NO_CHANGE, StaticCache, View
from splatreel.method.train.trainable_points import to_params
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

NEAR = 0.1
UNIT = 4.0
"""Viewing distance of `front_camera`, world units."""


def step_rows(gaussians: Gaussians, camera: Camera, repeats: int) -> list[Timing]:
    """Time a step of a keyframe, and a step of a group whose leftmost quarter of points is dynamic; forward and backward.

    `one_thread` is the slowdown on one thread. `undivided` is the slowdown if every tile is drawn, not only tiles with
    dynamic points.
    """
    view = View.of(camera)
    leftmost = np.argsort(gaussians.means[:, 0], kind="stable")
    quarter = len(gaussians) // 4
    still = StaticCache(gaussians[leftmost[quarter:]], [view], NEAR)
    keyframe, group = _step(gaussians, view), _step(gaussians[leftmost[:quarter]], view, still)
    many, one = medians_ms([keyframe, lambda: on_one_thread(keyframe)], repeats)
    divided, whole = medians_ms([group, lambda: group(divided=False)], repeats)
    return [
        {
            "what": "keyframe step",
            "points": len(gaussians),
            "threads": threads.count(),
            "ms": many,
            "one_thread": ratio(one, many),
        },
        {
            "what": "group step",
            "points": quarter,
            "still": len(still),
            "ms": divided,
            "undivided": ratio(whole, divided),
        },
    ]


def _step(gaussians: Gaussians, view: View, still: StaticCache | None = None) -> Callable[..., None]:
    """Return the gradients of one step as the CPU's programs compute them."""
    points = deform.DeformedPoints._make([*to_params(gaussians).values(), *NO_CHANGE])
    target, pinhole = np.zeros((view.height, view.width, 3), np.uint8), view.pinhole(NEAR)

    def step(divided: bool = True) -> None:
        opacities, seen = deform.forward(points, view.center, pinhole)
        static = None if still is None else still.view(0).frozen
        shapes = seen.means2d, seen.conics, opacities, seen.depths, seen.radii
        bins = bin_splats(*shapes, view.width, view.height)
        if static is not None and divided:
            found = photometric.loss_and_gradient_among(bins, seen.colors, static, target, 0.2, None, None)[1]
        else:
            image, alpha = rasterize.forward(bins, seen.colors, static)
            d_image = photometric.loss_and_gradient(image, target, 0.2).d_image
            nothing = rasterize.no_gradient(alpha.shape)
            found = rasterize.backward(bins, seen.colors, image, d_image, alpha, nothing, static)
        deform.backward(points, seen, view.center, pinhole, found.means2d, found.conics, found.colors, found.opacities)

    return step
