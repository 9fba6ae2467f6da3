"""A run on this machine alone: as many processes beside each other as its cores, its GPUs and its memory are good for."""

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
    """As `pipeline.reconstruct`, by several processes where a video has several chapters and that is quicker.

    workers: chapters that are made at a time; None: what suits the machine. Raises `UsageError` for more than there are cores,
    `ReconstructionError` where a chapter failed, once all others are finished, and what `pipeline.reconstruct` raises.
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
                pool.make(driver.todo, driver.hear)
                driver.finish()
        return result_of(run)


def division_of(run: ChapteredRun, workers: int | None = None) -> Division:
    """How the chapters of a run share this machine. workers: as many, whatever is quicker; no more than there are chapters.

    Raises `UsageError` for fewer than one worker or more than cores.
    """
    cores, chapters = threads.count(), len(run.chapters)
    if workers is not None:
        if not 1 <= workers <= cores:
            raise UsageError(
                f"--workers {workers} is out of range: this process has {cores} core{'s'[: cores > 1]}. Choose 1 to {cores}, or "
                "leave it out for as many as suit the machine."
            )
        workers = min(workers, chapters)
        return Division(workers, cores // workers)
    if run.device.type == "cuda":
        workers = max(1, min(torch.cuda.device_count(), chapters, cores))
        return Division(workers, cores // workers)
    free = free_memory()
    return divide(cores, chapters, None if free is None else max(1, free // _need(run)))


def places(run: ChapteredRun, workers: int) -> list[str | None]:
    """The GPU of each worker, as CUDA_VISIBLE_DEVICES names it; None where there is none."""
    if run.device.type != "cuda":
        return [None] * workers
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = visible.split(",") if visible else [str(index) for index in range(torch.cuda.device_count())]
    return [names[index % len(names)] for index in range(workers)]


def _need(run: ChapteredRun) -> int:
    return needed_memory(run.capture, run.config)
