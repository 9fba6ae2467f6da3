"""Compare a GPU with the CPU: the results of one training iteration, and images drawn per second."""

import math

import numpy as np

from bench.microbenchmarks import cloud, front_camera
from bench.timing import median_ms
from splatreel.base.progress import Silent
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.play.timeline import draw_on_cpu
from splatreel.run.device_choice import cuda_renderer
from splatreel.run.machine_speed import Probe, probe_training

NEAR = 0.1


def differences(probe: Probe, gpu: SharedGpu) -> dict[str, float]:
    """Compare an iteration of a keyframe: the largest difference of each gradient, as a share of the CPU's largest value."""
    found = []
    for each in (gpu, None):
        trainer, images = probe_training(each, probe)
        trainer.train(images, 1, 10**6, Silent())
        found.append({name: adam.mean for name, adam in trainer.points.adams.items()})
    if gpu.failure is not None:
        raise RuntimeError(gpu.failure)
    return {name: relative(found[0][name], value) for name, value in found[1].items()}


def relative(got: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest difference divided by the largest expected value.

    Raises:
        RuntimeError: A number is not finite.
    """
    error = float(np.abs(got - expected).max() / max(np.abs(expected).max(), 1e-12))
    if not math.isfinite(error):
        raise RuntimeError("the GPU found numbers that are not finite, in an iteration where the CPU did not")
    return float(f"{error:.3g}")


def drawing(points: int, width: int, height: int, repeats: int) -> dict[str, float]:
    """Return images drawn per second, as `splatreel view` does: copied from and to NumPy."""
    plain = cloud(points), front_camera(width, height), NEAR, False, (0.0, 0.0, 0.0)
    on_gpu = cuda_renderer()
    works = {"view cuda": lambda: on_gpu(*plain), "view cpu": lambda: draw_on_cpu(*plain)}
    return {name: round(1000 / median_ms(work, repeats), 1) for name, work in works.items()}
