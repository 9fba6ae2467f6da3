"""Time of a training iteration on a GPU, and on the CPU for comparison."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from splatreel.base.errors import GpuError
from splatreel.base.progress import Silent
from splatreel.config import KeyframeConfig
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.run.machine_speed import LARGE, SMALL, MachineSpeed, Probe, measure_speed, probe_scene

SECONDS = 2.0
"""Time that a measurement takes at least, after one batch to warm up."""
BATCH = 10
"""Iterations between two looks at the clock."""


def iteration_ms(gpu: SharedGpu | None, probe: Probe = SMALL, seconds: float = SECONDS) -> float:
    """Return the milliseconds of a keyframe's training iteration, with all threads of the CPU or on a GPU.

    Args:
        gpu: GPU that runs iterations; None measures the CPU.
        probe: Points and image size.
        seconds: Shortest time of the measurement.

    Raises:
        GpuError: The GPU fails.
    """
    trainer, images = probe_training(gpu, probe)
    taken = []
    while sum(taken[1:]) < seconds:
        start = time.perf_counter()
        trainer.train(images, BATCH, 10**6, Silent())
        taken.append(time.perf_counter() - start)
        if gpu is not None and gpu.failure is not None:
            raise GpuError(gpu.failure)
    return 1e3 * float(np.median(taken[1:])) / BATCH


def probe_training(gpu: SharedGpu | None, probe: Probe) -> tuple[KeyframeTrainer, TrainingImages]:
    """Return a training of random points against a random image, which adds no points. gpu: None trains on the CPU."""
    scene = probe_scene(probe)
    points = TrainablePoints.from_gaussians(scene.gaussians, default_rates(scene.unit))
    image = np.random.default_rng(0).integers(0, 256, (1, 1, probe.height, probe.width, 3), np.uint8)
    images = TrainingImages(image, [scene.view], scene.near, scene.unit)
    gains = CameraGains(1)
    config = KeyframeConfig(densify_every=10**9, average_share=0.0, detail=False)
    return KeyframeTrainer(points, gains, config, max_points=probe.points, gpu=gpu), images


def measure_run_speed(gpu: SharedGpu | None) -> MachineSpeed:
    """Return the speed of this machine for a run: `measure_speed`, with the training of a GPU if one trains.

    A GPU's time is that of a whole iteration, which is compared with the step on the machine that costs were measured on.

    Args:
        gpu: GPU that runs iterations of training; None runs them on the CPU.
    """
    speed = measure_speed()
    if gpu is None:
        return speed
    try:
        small, large = (1e-3 * iteration_ms(gpu, probe, SECONDS / 4) / probe.seconds for probe in (SMALL, LARGE))
    except GpuError:
        return speed
    return replace(speed, small=small, large=large)
