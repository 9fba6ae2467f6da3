"""How fast this machine is, beside the one that costs were measured on: one step of training, on points that are made up."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from splatreel import threads
from splatreel.kernels import splat
from splatreel.recon.train.points import TrainablePoints, default_rates
from splatreel.recon.train.render import View, deformed, draw
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

POINTS, WIDTH, HEIGHT = 20_000, 320, 180
REFERENCE = 0.0215
"""Seconds of a step on one thread of the machine that `costs` is of: it took 0.019 while that did little else, 0.0235 beside much other
work, and costs were measured at both times."""
REPEATS = 9
"""The quickest of so many is taken: what else the machine does takes none of them all."""
NEAR, DISTANCE = 0.1, 4.0


@dataclass(frozen=True)
class MachineSpeed:
    """How many times as long work takes here. training: of keyframes and groups, where they are trained; other: all else."""

    training: float = 1.0
    other: float = 1.0


def measure_speed(device: torch.device) -> MachineSpeed:
    """Takes about a second; some more where kernels have yet to be compiled."""
    other = _seconds(torch.device("cpu")) / REFERENCE
    return MachineSpeed(other if device.type == "cpu" else _seconds(device) / REFERENCE, other)


def on_one_thread(work: Callable[[], None]) -> None:
    """Run work on one thread."""
    with threads.limited(1):
        work()


def _seconds(device: torch.device) -> float:
    """Of a step: on the CPU what one thread takes of the processor."""
    step, found = _step(device), list[float]()

    def work() -> None:
        step()
        clock = time.process_time if device.type == "cpu" else time.perf_counter
        for _ in range(REPEATS):
            start = clock()
            step()
            found.append(clock() - start)

    on_one_thread(work)
    return min(found)


def _step(device: torch.device) -> Callable[[], None]:
    """One training step of random small points in a box before a camera, backward too."""
    rng = np.random.default_rng(0)
    sh = rng.normal(0, 0.02, (POINTS, 16, 3))
    sh[:, 0] = rng.normal(0, 0.5, (POINTS, 3))
    quats = rng.normal(size=(POINTS, 4))
    gaussians = Gaussians(
        means=rng.uniform(-1, 1, (POINTS, 3)) * [1.6, 0.9, 1.0],
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True),
        scales=np.exp(rng.normal(-4.2, 0.5, (POINTS, 3))),
        opacities=rng.uniform(0.1, 1, POINTS),
        sh=sh,
    )
    viewmat = np.eye(4)
    viewmat[2, 3] = DISTANCE
    K = np.array([[WIDTH, 0, WIDTH / 2], [0, WIDTH, HEIGHT / 2], [0, 0, 1]])
    view = View.of(Camera("front", viewmat, K, WIDTH, HEIGHT), device)
    points = TrainablePoints.from_gaussians(gaussians, default_rates(DISTANCE), device)
    target = torch.zeros((HEIGHT, WIDTH, 3), dtype=torch.uint8, device=device)

    def step() -> None:
        drawing = draw(deformed(points.params, None, None, view, NEAR), view, None)
        splat.photometric_loss(drawing.image, target, tiles=drawing.tiles).backward()
        points.clear()
        if device.type == "cuda":
            torch.cuda.synchronize(device)

    return step
