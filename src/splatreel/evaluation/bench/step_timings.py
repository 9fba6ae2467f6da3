"""Timings of training steps on the CPU, each alternating with the same step without an optimization."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from splatreel.base import threads
from splatreel.evaluation.bench.timing import Timing, medians_ms, ratio
from splatreel.method.train.render import StaticCache, View, deformed, draw, moving_tiles
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.run.machine_speed import on_one_thread
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
    view = View.of(camera, torch.device("cpu"))
    leftmost = np.argsort(gaussians.means[:, 0], kind="stable")
    quarter = len(gaussians) // 4
    still = StaticCache(gaussians[leftmost[quarter:]], [view], NEAR, torch.device("cpu"))
    keyframe, group = _step(gaussians, view), _step(gaussians[leftmost[:quarter]], view, still)
    many, one = medians_ms([keyframe, lambda: on_one_thread(keyframe)], repeats)
    layered, whole = medians_ms([group, lambda: group(layered=False)], repeats)
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
            "ms": layered,
            "undivided": ratio(whole, layered),
        },
    ]


def _step(gaussians: Gaussians, view: View, still: StaticCache | None = None) -> Callable[..., None]:
    p = TrainablePoints.from_gaussians(gaussians, default_rates(UNIT), torch.device("cpu"))
    target = torch.zeros((view.height, view.width, 3), dtype=torch.uint8)

    def step(layered: bool = True) -> None:
        moving = deformed(p.params, None, None, view, NEAR)
        static = still.view(0) if still else None
        among = moving_tiles(moving, view, static) if layered and static else None
        (among or draw(moving, view, static, layered=False)).loss(target, 0.2, None).backward()
        p.clear()

    return step
