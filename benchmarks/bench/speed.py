"""Speed of a reconstruction, as ratios within one run, because seconds differ between machines and days."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.timing import Timing, medians_ms, on_one_thread, ratio
from splatreel.base import threads
from splatreel.base.errors import UsageError
from splatreel.base.process import peak_memory_bytes
from splatreel.base.progress import Progress, Silent
from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.evaluation.evaluate import evaluate
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.kernels import splat
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.rig import Rig
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.cpu_program import CpuGroupProgram
from splatreel.method.train.density import MEASURE_EVERY
from splatreel.method.train.group_trainer import GroupTrainer
from splatreel.method.train.stages import group_trainer
from splatreel.run.device_choice import pick_gpu
from splatreel.run.pipeline import Result, reconstruct
from splatreel.run.steps import restored_rig
from splatreel.run.store import Store
from splatreel.scene.gaussians import StaticPoints
from splatreel.scene.group import GroupSpan

BATCH = 8
"""Iterations timed together. Each uses another camera and frame."""


def bench_reconstruct(
    capture: Capture,
    out: Path,
    configs: dict[str, Config],
    *,
    device: str = "auto",
    loop: int | None = None,
    repeats: int = 5,
    progress: Progress | None = None,
) -> list[Timing]:
    """Reconstruct with every configuration into OUT/<name>, then time training iterations. The first configuration is the reference.

    The same call continues after an interruption. Memory is that of this process.

    Args:
        capture: Capture to reconstruct.
        out: Output folder.
        configs: Configurations by name.
        device: auto, cpu, gpu or cuda.
        loop: Also reconstruct the first configuration with the capture repeated for this many frames, and report the
            additional memory.
        repeats: Number of timings; the median counts.
        progress: Progress display.

    Raises:
        UsageError: `loop` is not larger than the number of frames.
    """
    progress = progress or Silent()
    if loop is not None and loop <= capture.frames:
        raise UsageError(
            f"--loop {loop} is out of range: the capture has {capture.frames} frames. Choose more than that."
        )
    (name, config), *others = configs.items()
    first, result = _run(capture, out, name, config, device, progress)
    rows = [first]
    trainer = trainer_of(capture, result.work, config, pick_gpu(device)[0])
    if len(trainer.points):
        rows.append(iteration_row(trainer, repeats))
    del trainer
    if loop is not None:
        looped, _ = _run(LoopedCapture(capture, loop), out, f"{name} looped", config, device, progress)
        looped["more_memory_mb"] = round(float(looped["peak_memory_mb"]) - float(first["peak_memory_mb"]), 1)
        rows.append(looped)
    for other, settings in others:
        row, _ = _run(capture, out, other, settings, device, progress)
        row["times_as_long"] = ratio(float(row["seconds"]), float(first["seconds"]))
        if "psnr" in first:
            row["psnr_more"] = round(float(row["psnr"]) - float(first["psnr"]), 3)
        rows.append(row)
    return rows


def _run(
    capture: Capture, out: Path, name: str, config: Config, device: str, progress: Progress
) -> tuple[Timing, Result]:
    """Reconstruct and, with held-out cameras, evaluate the decoded reel.

    `seconds_a_megapixel` is per frame and per million pixels of one camera's image.
    """
    result = reconstruct(capture, out / name.replace(" ", "-"), config, device=device, progress=progress)
    seconds = sum(result.seconds.values())
    megapixels = capture.width * capture.height / 1e6
    row: Timing = {
        "what": name,
        "frames": capture.frames,
        "seconds": round(seconds, 1),
        "seconds_a_frame": round(seconds / capture.frames, 3),
        "seconds_a_megapixel": round(seconds / capture.frames / megapixels, 3),
        **{f"{stage}_share": round(spent / seconds, 3) for stage, spent in result.seconds.items()},
        "peak_memory_mb": round((peak_memory_bytes() or 0) / 1e6, 1),
    }
    if capture.held_out:
        report = evaluate(result.reel, capture, device=result.device, progress=progress)
        row["psnr"] = round(report.psnr, 3)
        row["psnr_color_fitted"] = round(report.psnr_color_fitted or report.psnr, 3)
    return row, result


def trainer_of(capture: Capture, work: Path, config: Config, gpu: SharedGpu | None) -> GroupTrainer:
    """Return a trainer of the first group of a finished run, in its final state. It measures static points as often as possible."""
    store = Store(work)
    group, layout = store.group(0).group().group, store.layout()
    assert layout is not None
    rig = restored_rig(Rig.of(capture.training_cameras), store.group(0), group.frames)
    images = capture.read(group.first_frame, group.frames, rig.names)
    span = GroupSpan(0, group.first_frame, group.frames, group.frames)
    rig = dataclasses.replace(rig, ends=())
    data = GroupInput(span, images, rig, None, layout, config.seed, config.antialias, gpu=gpu)
    config = dataclasses.replace(
        config,
        layering=dataclasses.replace(config.layering, adapt_every=1),
        group=dataclasses.replace(config.group, coarse_share=0.0, time_offsets=False),
    )
    start = GroupStart(group.dynamic, group.dynamic.means + group.dx)
    return group_trainer(data, start, StaticPoints(store.static(0), group.alive), config)


def iteration_row(trainer: GroupTrainer, repeats: int) -> Timing:
    """Time an iteration of a group, as the median of batches.

    `undivided` is the slowdown if every tile is drawn and static points get gradients. `one_thread` is the slowdown on
    one thread. `tiles` is the mean share of tiles with dynamic points.
    """
    middle = trainer.iterations // 2 // MEASURE_EVERY * MEASURE_EVERY
    # Both have the same regularizers.
    layered, whole = (_batch(trainer, at) for at in (middle + MEASURE_EVERY // 2, middle))
    trainer.start_program(Silent())
    layered()  # warm up; the loop below draws the static points of every view
    for camera in range(len(trainer.images.views)):
        trainer.static.view(camera)
    works = [layered, whole]
    if isinstance(trainer.program, CpuGroupProgram):
        works.append(lambda: on_one_thread(layered))
    times = medians_ms(works, repeats)
    row: Timing = {
        "what": "group iteration",
        "points": len(trainer.points),
        "still": int(trainer.static.alive.sum()),
        "ms": round(times[0] / BATCH, 3),
        "undivided": ratio(times[1], times[0]),
        "tiles": round(_tiles(trainer), 3),
    }
    if len(times) < 3:
        return row
    return {**row, "threads": threads.count(), "one_thread": ratio(times[2], times[0])}


def _batch(trainer: GroupTrainer, iteration: int) -> Callable[[], None]:
    """Return a function that runs a batch of like iterations."""

    def work() -> None:
        assert trainer.program is not None
        trainer.program.run([trainer.plan(iteration) for _ in range(BATCH)])

    return work


def _tiles(trainer: GroupTrainer) -> float:
    """Return the share of tiles with dynamic points."""
    shares = []
    for camera, view in enumerate(trainer.images.views):
        moving = trainer.points.at(camera % trainer.images.count, view, trainer.images.near)
        shares.append(float((splat.bin(moving, view.width, view.height).counts > 0).mean()))
    return sum(shares) / len(shares)


class LoopedCapture(Capture):
    """Capture that repeats the frames of another one. The caller closes the source."""

    def __init__(self, source: Capture, frames: int) -> None:
        self.source = source
        super().__init__(
            source.path,
            source.cameras,
            held_out=source.held_out,
            frame_range=(0, frames),
            fps=source.fps,
            points=source.points,
            point_colors=source.point_colors,
            near=source.near,
        )

    def sources(self) -> list[Path]:
        """Return the files that are read."""
        return self.source.sources()

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        done = 0
        while done < len(out):
            frame = (first + done) % self.source.frames
            count = min(self.source.frames - frame, len(out) - done)
            out[done : done + count] = self.source.read(frame, count, cameras)
            done += count
