"""How fast this machine is, beside the one that costs were measured on: a step of training on random points, at two picture sizes."""

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


@dataclass(frozen=True)
class Probe:
    """A training step that is timed: so many points in a picture of that size. scale: mean logarithm of the points' scales.

    seconds: what it takes on one thread of the machine that `costs` is of. repeats: the quickest of so many steps counts, so that what
    else the machine does hardly matters.
    """

    points: int
    width: int
    height: int
    scale: float
    seconds: float
    repeats: int

    @property
    def megapixels(self) -> float:
        return self.width * self.height / 1e6


SMALL = Probe(20_000, 320, 180, -4.2, 0.0215, 9)
"""It took 0.019 s on that machine (AMD Zen 5) beside little else, 0.0235 s beside much; costs were measured at both times."""
LARGE = Probe(46_000, 1280, 720, -4.6, 0.172, 5)
"""As many points as pictures of this size get. Measured on an Intel Sapphire Rapids, which also has AVX-512, and scaled by what the
small probe takes on Zen 5 and there."""
KERNEL_GAIN = 0.75
"""Share of a step's time that the present training kernels take of the ones that costs were measured with: 0.73 with AVX-512, 0.85 with
AVX2. Other work did not become faster."""
NEAR, DISTANCE = 0.1, 4.0


@dataclass(frozen=True)
class MachineSpeed:
    """How many times as long work takes here as where costs were measured.

    small, large: training of keyframes and groups with pictures of the size of `SMALL` and of `LARGE`. Processors differ in the ratio
    of the two: large pictures need memory bandwidth, small ones fit into caches. other: all that runs on the CPU besides training.
    """

    small: float = 1.0
    large: float = 1.0
    other: float = 1.0

    def training(self, megapixels: float) -> float:
        """Return the factor of training with pictures of that size: in between by the logarithm of the size, outside the nearer one."""
        ends = np.log([SMALL.megapixels, LARGE.megapixels])
        return float(np.exp(np.interp(np.log(max(megapixels, 1e-6)), ends, np.log([self.small, self.large]))))


def measure_speed(device: torch.device) -> MachineSpeed:
    """Time both probes. Takes two seconds; some more where kernels have yet to be compiled."""
    small, large = (_seconds(probe, device) / probe.seconds for probe in (SMALL, LARGE))
    on_cpu = small if device.type == "cpu" else _seconds(SMALL, torch.device("cpu")) / SMALL.seconds
    return MachineSpeed(small, large, on_cpu / KERNEL_GAIN)


def on_one_thread(work: Callable[[], None]) -> None:
    """Run work on one thread."""
    with threads.limited(1):
        work()


def _seconds(probe: Probe, device: torch.device) -> float:
    """Return what a step takes: on the CPU, processor time of one thread."""
    step, found = _step(probe, device), list[float]()

    def work() -> None:
        step()
        clock = time.process_time if device.type == "cpu" else time.perf_counter
        for _ in range(probe.repeats):
            start = clock()
            step()
            found.append(clock() - start)

    on_one_thread(work)
    return min(found)


def _step(probe: Probe, device: torch.device) -> Callable[[], None]:
    """Return one training step of random small points in a box before a camera, backward too."""
    rng, count = np.random.default_rng(0), probe.points
    sh = rng.normal(0, 0.02, (count, 16, 3))
    sh[:, 0] = rng.normal(0, 0.5, (count, 3))
    quats = rng.normal(size=(count, 4))
    gaussians = Gaussians(
        means=rng.uniform(-1, 1, (count, 3)) * [1.6, 0.9, 1.0],
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True),
        scales=np.exp(rng.normal(probe.scale, 0.5, (count, 3))),
        opacities=rng.uniform(0.1, 1, count),
        sh=sh,
    )
    viewmat = np.eye(4)
    viewmat[2, 3] = DISTANCE
    width, height = probe.width, probe.height
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]])
    view = View.of(Camera("front", viewmat, K, width, height), device)
    points = TrainablePoints.from_gaussians(gaussians, default_rates(DISTANCE), device)
    target = torch.zeros((height, width, 3), dtype=torch.uint8, device=device)

    def step() -> None:
        drawing = draw(deformed(points.params, None, None, view, NEAR), view, None)
        splat.photometric_loss(drawing.image, target, tiles=drawing.tiles).backward()
        points.clear()
        if device.type == "cuda":
            torch.cuda.synchronize(device)

    return step
