"""Timings of training steps on the CPU, each against the same without what makes it quick, measured in turns."""

from __future__ import annotations

import time
from collections.abc import Callable

import numba
import numpy as np
import torch

from splatreel.kernels import splat
from splatreel.recon.train.points import TrainablePoints, default_rates
from splatreel.recon.train.render import StaticCache, View, deformed, draw
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

Row = dict[str, float | int | str]
NEAR = 0.1
UNIT = 4.0
"""Near plane and viewing distance of `bench.front_camera`, world units."""


def step_rows(gaussians: Gaussians, camera: Camera, repeats: int) -> list[Row]:
    """A step of a keyframe, and one of a group in which the leftmost quarter of the points moves; forward and backward.

    `one_thread`, `undivided`: how many times as long it takes on one thread, and drawing every tile and not only those
    that something moves in.
    """
    view = View.of(camera, torch.device("cpu"))
    leftmost = np.argsort(gaussians.means[:, 0], kind="stable")
    quarter = len(gaussians) // 4
    still = StaticCache(gaussians[leftmost[quarter:]], [view], NEAR, torch.device("cpu"))
    keyframe, group = _step(gaussians, view), _step(gaussians[leftmost[:quarter]], view, still)
    threads = numba.get_num_threads()
    many, one = medians([keyframe, lambda: on_one_thread(keyframe, threads)], repeats)
    layered, whole = medians([group, lambda: group(layered=False)], repeats)
    return [
        {
            "what": "keyframe step",
            "points": len(gaussians),
            "threads": threads,
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
        drawing = draw(moving, view, still.view(0) if still else None, layered)
        splat.photometric_loss(drawing.image, target, tiles=drawing.tiles).backward()
        p.clear()

    return step


def on_one_thread(work: Callable[[], None], threads: int) -> None:
    """Do it on one thread, and use `threads` again afterwards."""
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    try:
        work()
    finally:
        numba.set_num_threads(threads)
        torch.set_num_threads(threads)


def medians(works: list[Callable[[], None]], repeats: int) -> list[float]:
    """Median milliseconds of each, one after the other in turns: what else the machine does falls on all."""
    times: list[list[float]] = [[] for _ in works]
    for turn in range(repeats + 1):
        for work, measured in zip(works, times, strict=True):
            start = time.perf_counter()
            work()
            if turn:  # the first may compile
                measured.append(1000 * (time.perf_counter() - start))
    return [round(float(np.median(measured)), 3) for measured in times]


def ratio(slow: float, quick: float) -> float:
    """slow / quick, to two places."""
    return round(slow / quick, 2)
