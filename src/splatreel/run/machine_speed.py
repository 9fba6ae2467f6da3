"""Speed of this machine's CPU and GPU, measured by training iterations, and the name of its processor."""

from __future__ import annotations

import functools
import hashlib
import json
import math
import platform
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import llvmlite.binding as llvm
import numpy as np

from splatreel import __version__
from splatreel.base import threads, user_cache
from splatreel.base.errors import GpuError
from splatreel.base.progress import Silent
from splatreel.config import KeyframeConfig
from splatreel.gpu.adapters import Adapter
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.render import View
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

KERNEL_GAIN = 0.75
"""Time of an iteration with the present training kernels, as a share of that with the kernels that costs were measured with: 0.73 with
AVX-512, 0.85 with AVX2. Other work did not become faster."""
NEAR, DISTANCE = 0.1, 4.0
CPUINFO = Path("/proc/cpuinfo")
WIDTHS = {"avx512f": "AVX-512", "avx2": "AVX2", "sve": "SVE", "neon": "NEON"}
"""Widest vector instructions that kernels are compiled for, by LLVM's name of the feature, the widest first."""


@dataclass(frozen=True)
class Probe:
    """A training iteration on random points that is timed.

    Attributes:
        scale: Mean logarithm of the points' scales.
        seconds: Seconds of the iteration on one thread of the machine that `costs` was measured on.
        repeats: Number of iterations. The fastest counts, so that other programs hardly matter.
    """

    points: int
    width: int
    height: int
    scale: float
    seconds: float
    repeats: int

    @property
    def megapixels(self) -> float:
        """Megapixels of the image."""
        return self.width * self.height / 1e6


SMALL = Probe(20_000, 320, 180, -4.2, 0.0237, 9)
"""The gradients of the iteration took 0.019 s on that machine (AMD Zen 5) when it was idle, and 0.0235 s when it was busy. Costs were
measured at both times. A whole iteration takes 1.1 times as long: 1.11 times at this size, 1.09 times at that of `LARGE`."""
LARGE = Probe(46_000, 1280, 720, -4.6, 0.189, 5)
"""Number of points that images of this size get. Measured on an Intel Sapphire Rapids, which also has AVX-512, and scaled by the time
of the small iteration on both machines."""


@dataclass(frozen=True)
class MachineSpeed:
    """Seconds of work on this machine as a multiple of those on the machine that was measured.

    Processors differ in the ratio of `small` and `large`: large images need memory bandwidth, small images fit into caches.

    Attributes:
        small: Training with images of the size of `SMALL`.
        large: Training with images of the size of `LARGE`.
        other: Everything else, which runs on the CPU.
    """

    small: float = 1.0
    large: float = 1.0
    other: float = 1.0

    def training(self, megapixels: float) -> float:
        """Return the factor of training with images of that size, interpolated between the two by its logarithm."""
        ends = np.log([SMALL.megapixels, LARGE.megapixels])
        return float(np.exp(np.interp(np.log(max(megapixels, 1e-6)), ends, np.log([self.small, self.large]))))


def measure_speed() -> MachineSpeed:
    """Time iterations of both sizes on the CPU. This takes two seconds, and longer where kernels must be compiled first."""
    small, large = (_seconds(probe) / probe.seconds for probe in (SMALL, LARGE))
    return MachineSpeed(small, large, small / KERNEL_GAIN)


def _seconds(probe: Probe) -> float:
    """Return the seconds of processor time that an iteration takes on one thread."""
    trainer, images = probe_training(None, probe)
    found = []
    with threads.limited(1):
        for _ in range(1 + probe.repeats):
            start = time.process_time()
            trainer.train(images, 1, 10**6, Silent())
            found.append(time.process_time() - start)
    return min(found)


@functools.cache
def processor_name() -> str:
    """Return the model, such as `AMD EPYC 7763 64-Core Processor`, or the architecture where the system does not tell the model."""
    return " ".join((_model() or platform.processor() or platform.machine() or "unknown processor").split())


def describe_processor() -> str:
    """Return a description such as `AMD EPYC 7763 64-Core Processor with AVX2, 2 cores`."""
    features, cores = llvm.get_host_cpu_features(), threads.available()
    width = next((f" with {name}" for feature, name in WIDTHS.items() if features.get(feature)), "")
    return f"{processor_name()}{width}, {cores} core{'s'[: cores > 1]}"


def _model() -> str:
    """Return the model as the operating system tells it, or an empty text."""
    try:
        if sys.platform == "linux":
            lines = CPUINFO.read_text(encoding="utf-8", errors="replace").splitlines()
            fields = dict(reversed([[part.strip() for part in line.split(":", 1)] for line in lines if ":" in line]))
            return fields.get("model name") or fields.get("Model") or ""
        if sys.platform == "darwin":
            command = ["sysctl", "-n", "machdep.cpu.brand_string"]
            return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout
        if sys.platform == "win32":
            import winreg

            with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, r"HARDWARE\DESCRIPTION\System\CentralProcessor\0") as key:
                return str(winreg.QueryValueEx(key, "ProcessorNameString")[0])
    except (OSError, subprocess.SubprocessError):
        pass
    return ""


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


class DeviceTimes(NamedTuple):
    """Milliseconds of a training iteration on the CPU, with all threads, and on a GPU."""

    cpu: float
    gpu: float


def device_times(adapter: Adapter, megapixels: float, renew: bool = False) -> DeviceTimes:
    """Measure how fast the CPU and a GPU train, about five seconds. Results are kept in the user's cache.

    Args:
        adapter: The GPU.
        megapixels: Size of the images. Of the two probes, the one whose size is nearer is timed.
        renew: Measure also if there is a result.

    Raises:
        GpuError: The GPU fails.
    """
    probe = min(SMALL, LARGE, key=lambda each: abs(math.log(each.megapixels / max(megapixels, 1e-6))))
    machine = f"{__version__} {processor_name()} {threads.count()} {adapter.name} {adapter.route} {probe.width}"
    name = f"speed/{hashlib.sha256(machine.encode()).hexdigest()[:16]}.json"
    if not renew and (kept := _read_times(name)) is not None:
        return kept
    found = DeviceTimes(iteration_ms(None, probe), iteration_ms(SharedGpu(adapter), probe))
    user_cache.save(name, json.dumps(found._asdict()).encode())
    return found


def _read_times(name: str) -> DeviceTimes | None:
    """Return the times that a file of the cache holds; None if it holds none."""
    try:
        found = DeviceTimes(**{key: float(value) for key, value in json.loads(user_cache.load(name) or b"").items()})
    except (ValueError, TypeError, AttributeError):
        return None
    return found if all(math.isfinite(value) and value > 0 for value in found) else None


def probe_training(gpu: SharedGpu | None, probe: Probe) -> tuple[KeyframeTrainer, TrainingImages]:
    """Return a training of small random points in a box in front of a camera, against a random image. It adds no points.

    Args:
        gpu: GPU that runs iterations; None trains on the CPU.
        probe: Points and image size.
    """
    rng, count, width, height = np.random.default_rng(0), probe.points, probe.width, probe.height
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
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]])
    view = View.of(Camera("front", viewmat, K, width, height))
    points = TrainablePoints.from_gaussians(gaussians, default_rates(DISTANCE))
    image = np.random.default_rng(0).integers(0, 256, (1, 1, height, width, 3), np.uint8)
    images = TrainingImages(image, [view], NEAR, DISTANCE)
    config = KeyframeConfig(densify_every=10**9, average_share=0.0, detail=False)
    return KeyframeTrainer(points, CameraGains(1), config, max_points=count, gpu=gpu), images


def measure_run_speed(gpu: SharedGpu | None) -> MachineSpeed:
    """Return the speed of this machine for a run: `measure_speed`, with the training of a GPU if one trains.

    A GPU's iteration is compared with that on the machine that costs were measured on.

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
