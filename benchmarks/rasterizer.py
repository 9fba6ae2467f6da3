"""Measure the CPU rasterizer, projection and deformation, and the time to compile them: processor time of one thread.

python benchmarks/rasterizer.py [--record] [--note TEXT]

Another processor can be compiled for by numba's own variables, such as NUMBA_CPU_NAME=znver3 with NUMBA_CPU_FEATURES; a fresh
NUMBA_CACHE_DIR makes it compile. Runs with earlier revisions too: PYTHONPATH=OTHER/src.
"""

import contextlib
import os
import time
from collections.abc import Callable
from typing import Annotated

os.environ.setdefault("NUMBA_NUM_THREADS", "1")  # of revisions whose kernels ran on numba's own threads

import numpy as np
import tyro

from record import record
from splatreel.kernels import binning, deform, project, rasterize

SCENES = ((20_000, 320, 240), (100_000, 640, 480))
POINTS = 5000


def main(repeats: int = 9, note: str = "", save: Annotated[bool, tyro.conf.arg(name="record")] = False) -> None:
    """Print the figures; with --record, also append them to results.jsonl.

    Args:
        repeats: The least of so many measurements is taken.
        note: What else is to be known about this run.
        save: Append a line to results.jsonl.
    """
    with contextlib.suppress(ImportError):  # earlier revisions have no threads of their own
        from splatreel.base import threads

        threads.use(1)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    found: dict[str, dict[str, float]] = {}
    start = time.process_time()
    measure(60, 32, 24, 1)
    measure_points(100, 1)
    compiling = round(time.process_time() - start, 2)
    for count, width, height in SCENES:
        found[f"{count} {width}x{height}"] = row = measure(count, width, height, repeats)
        print(f"{count} {width}x{height}: " + ", ".join(f"{name} {value:.2f}" for name, value in row.items()))
    found[f"{POINTS} points"] = row = measure_points(POINTS, 4 * repeats)
    print(f"{POINTS} points: " + ", ".join(f"{name} {value:.1f}" for name, value in row.items()))
    print(f"first call: {compiling} s")
    if save:
        processor = os.environ.get("NUMBA_CPU_NAME", "host")
        record("rasterizer", {"ns": found, "first_call_seconds": compiling, "compiled_for": processor}, note)


def measure(count: int, width: int, height: int, repeats: int) -> dict[str, float]:
    """Return milliseconds of binning, and nanoseconds per splat and tile that it touches of the forward and the backward pass."""
    means, conics, opacities, depths, radii, colors = splats(count, width, height)
    bins = binning.bin_splats(means, conics, opacities, depths, radii, width, height)
    image, alpha = rasterize.forward(bins, colors)
    d_image = np.random.default_rng(1).normal(size=image.shape).astype(np.float32)
    d_alpha = np.zeros_like(alpha)
    pairs = len(bins.ids)
    parts = {
        "binning ms": (1e3, lambda: binning.bin_splats(means, conics, opacities, depths, radii, width, height)),
        "forward": (1e9 / pairs, lambda: rasterize.forward(bins, colors)),
        "backward": (1e9 / pairs, lambda: rasterize.backward(bins, colors, image, d_image, alpha, d_alpha)),
    }
    return {name: round(scale * least_seconds(work, repeats), 3) for name, (scale, work) in parts.items()}


def measure_points(count: int, repeats: int) -> dict[str, float]:
    """Return nanoseconds per point of projection and deformation, with harmonics of degree 2."""
    rng = np.random.default_rng(0)

    def normal(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32)

    means, quats, log_scales = (
        normal(count, 3) + np.array([0, 0, 5], np.float32),
        normal(count, 4),
        0.3 * normal(count, 3) - 3,
    )
    turns = 0.01 * normal(count, 4) + np.array([1, 0, 0, 0], np.float32)
    color = normal(count, 1, 3), normal(count, 8, 3)
    changes = 0.01 * normal(count, 3), turns, 0.01 * normal(count, 4)
    moment = deform.DeformedPoints(means, quats, log_scales, normal(count), *color, *changes)
    K = np.array([[300, 0, 160], [0, 300, 120], [0, 0, 1]], np.float32)
    view, center = project.Pinhole(np.eye(4, dtype=np.float32), K, 320, 240, 0.01), np.zeros(3, np.float32)
    _, seen = deform.forward(moment, center, view)
    slopes = normal(count, 2), normal(count, 3), normal(count, 3), normal(count)
    flat = slopes[0], slopes[1], slopes[3], seen.radii, view
    parts = {
        "project": lambda: project.forward(means, quats, seen.scales, view),
        "project backward": lambda: project.backward(means, quats, seen.scales, seen.conics, *flat),
        "deform": lambda: deform.forward(moment, center, view),
        "deform backward": lambda: deform.backward(moment, seen, center, view, *slopes),
    }
    calls = 20  # one call takes less time than the clock and the caches need to settle
    return {
        name: round(1e9 / count / calls * least_seconds(lambda work=work: [work() for _ in range(calls)], repeats), 1)
        for name, work in parts.items()
    }


def least_seconds(work: Callable[[], object], repeats: int) -> float:
    """Return the least processor time of several calls."""
    found = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        found.append(time.process_time() - start)
    return min(found)


def splats(count: int, width: int, height: int) -> tuple[np.ndarray, ...]:
    """Return means2d, conics, opacities, depths, radii and colors of splats with a log-normal radius of 4 pixels."""
    rng = np.random.default_rng(0)
    long = np.clip(rng.lognormal(np.log(4) - 0.32, 0.8, count), 0.8, 24) / 3.33
    short = long * rng.uniform(0.2, 1, count)
    angle = rng.uniform(0, np.pi, count)
    c, s = np.cos(angle), np.sin(angle)
    xx, yy = c * c * long**2 + s * s * short**2 + 0.3, s * s * long**2 + c * c * short**2 + 0.3
    xy = c * s * (long**2 - short**2)
    conics = np.stack([yy, -xy, xx], 1) / (xx * yy - xy * xy)[:, None]
    opacities = 1 / (1 + np.exp(-rng.normal(0.3, 1.5, count)))
    arrays = rng.random((count, 2)) * [width, height], conics, opacities, rng.uniform(2, 10, count)
    means, conics, opacities, depths = (array.astype(np.float32) for array in arrays)
    return means, conics, opacities, depths, np.full(count, 80, np.int32), rng.random((count, 3)).astype(np.float32)


if __name__ == "__main__":
    tyro.cli(main)
