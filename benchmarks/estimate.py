"""Compare estimates of `reconstruct --estimate` with runs: processor time and memory.

python benchmarks/estimate.py
"""

import multiprocessing
import shutil
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Literal

import tyro

from record import record
from splatreel.base import threads
from splatreel.base.process import keep_freed_memory, peak_memory_bytes, quiet_threads
from splatreel.capture.opening import open_capture
from splatreel.config import Quality, preset
from toyroom.capture import make_capture

Case = tuple[Quality, int, int, int]
CASES: tuple[Case, ...] = (("draft", 160, 90, 30), ("standard", 160, 90, 45), ("draft", 320, 180, 10))
"""Quality, width, height and frames of the built-in capture, the cheapest first."""


def main(cases: Literal[1, 2, 3] = 1, out: Path = Path("out/benchmark-estimate"), note: str = "") -> None:
    """Film, estimate, reconstruct on one thread, and record each case."""
    for case in CASES[:cases]:
        fresh = multiprocessing.get_context("spawn")  # the peak of memory is of a process
        with ProcessPoolExecutor(1, mp_context=fresh) as pool:
            found = pool.submit(measure, case, out).result()
        record("estimate", found, note)
        print(found)


def measure(case: Case, out: Path) -> dict:
    """Return the estimated and the measured figures. Estimates leave out the compilation of kernels."""
    quiet_threads()
    threads.use(1)
    keep_freed_memory()
    from splatreel.base.display import console
    from splatreel.run.estimate import estimate
    from splatreel.run.machine_speed import measure_speed
    from splatreel.run.machines.local_processes import division_of
    from splatreel.run.pipeline import RunSpec, reconstruct_run

    quality, width, height, frames = case
    folder = out / f"{quality}-{width}x{height}-{frames}"
    shutil.rmtree(folder / "run", ignore_errors=True)
    if not (folder / "capture").exists():
        make_capture(folder / "capture", width=width, height=height, frames=frames)
    spec = RunSpec(partial(open_capture, folder / "capture"), folder / "run", preset(quality), "none", "cpu")
    with spec.opened() as run:
        speed = measure_speed()
        said = estimate(run, division_of(run), speed)
        start = time.process_time()
        result = reconstruct_run(run, console(), lambda *_: None)
        taken = time.process_time() - start
    return {
        "quality": quality,
        "width": width,
        "height": height,
        "frames": frames,
        "pace": round(speed.small, 3),
        "pace_large": round(speed.large, 3),
        "moving": round(said.moving, 3),
        "estimated": {stage: round(seconds, 2) for stage, seconds in said.seconds.items()},
        "estimated_total": round(said.total, 1),
        "seconds": result.seconds,
        "processor_total": round(taken, 1),
        "estimated_memory_bytes": said.memory,
        "peak_memory_bytes": peak_memory_bytes(),
    }


if __name__ == "__main__":
    tyro.cli(main)
