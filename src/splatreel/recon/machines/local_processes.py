"""A run on this machine alone, by as many processes as its cores, GPUs and memory suit."""

from __future__ import annotations

import os

import torch

from splatreel import threads
from splatreel.errors import UsageError
from splatreel.progress import Progress, Silent, parts_of
from splatreel.recon.encode.group_writer import PresentationHook, no_presentation
from splatreel.recon.jobs import ChapteredRun, scene_job
from splatreel.recon.machines.driver import Driver
from splatreel.recon.machines.run_spec import RunSpec
from splatreel.recon.machines.scaling import Division, divide
from splatreel.recon.machines.worker_pool import WorkerPool
from splatreel.recon.pipeline import Result, reconstruct_run, result_of
from splatreel.recon.run.memory import free_memory, needed_memory


def reconstruct_here(
    spec: RunSpec,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    present: PresentationHook = no_presentation,
) -> Result:
    """Reconstruct a run like `pipeline.reconstruct`, by several processes where a video has several chapters and that is faster.

    Args:
        spec: The run.
        workers: Number of chapters that are made at a time; None chooses a number that suits the machine.
        progress: Display of the progress; nothing is shown by default.
        present: Adds poster and thumbnails to the reel.

    Raises:
        UsageError: There are fewer cores than workers.
        ReconstructionError: A chapter failed. All other chapters are finished first.
        SplatreelError: As `pipeline.reconstruct` raises it.
    """
    progress = progress or Silent()
    with spec.opened() as run:
        division = division_of(run, workers)
        if division.workers == 1:
            return reconstruct_run(run, progress, present)
        with run.lock():
            scene_job(run, parts_of(progress, run.costs())[0])
            if run.device.type == "cuda":
                torch.cuda.empty_cache()  # for the worker that uses the same GPU
            driver = Driver(run, progress, present, division.workers)
            with driver, WorkerPool(spec, places(run, division.workers), division.threads, _need(run)) as pool:
                pool.make(driver.todo, driver.receive)
                driver.finish()
        return result_of(run)


def division_of(run: ChapteredRun, workers: int | None = None) -> Division:
    """Return how the chapters of a run share this machine.

    Args:
        run: The run.
        workers: Number of workers, limited by the number of chapters; None chooses the fastest division.

    Raises:
        UsageError: There are less than one or more workers than cores.
    """
    cores, chapters = threads.count(), len(run.chapters)
    if workers is not None:
        if not 1 <= workers <= cores:
            raise UsageError(
                f"--workers {workers} is out of range: this process has {cores} core{'s'[: cores > 1]}. Choose 1 to {cores}, or "
                "leave the option out for a number that suits the machine."
            )
        workers = min(workers, chapters)
        return Division(workers, cores // workers)
    if run.device.type == "cuda":
        workers = max(1, min(torch.cuda.device_count(), chapters, cores))
        return Division(workers, cores // workers)
    free = free_memory()
    return divide(cores, chapters, None if free is None else max(1, free // _need(run)))


def places(run: ChapteredRun, workers: int) -> list[str | None]:
    """Return the GPU of each worker, as CUDA_VISIBLE_DEVICES names it; None for a worker without a GPU."""
    if run.device.type != "cuda":
        return [None] * workers
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = visible.split(",") if visible else [str(index) for index in range(torch.cuda.device_count())]
    return [names[index % len(names)] for index in range(workers)]


def _need(run: ChapteredRun) -> int:
    return needed_memory(run.capture, run.config)
