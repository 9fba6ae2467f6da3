"""Estimate of the time and memory of a run, and the division of this machine's cores."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from splatreel.capture.base import Capture
from splatreel.method.images.change import changed_pixels
from splatreel.run.costs import Workload, chapter_plan, scene_plan, sequence_plan
from splatreel.run.job import Seconds, sum_seconds
from splatreel.run.jobs import ChapteredRun
from splatreel.run.machine_speed import MachineSpeed
from splatreel.run.requirements import PROCESS, needed_memory
from splatreel.run.steps import STEPS

LOOKS = 3
"""Number of frames of the first group that are compared to measure how much moves."""
LOOKED_AT = 6e6
"""Largest number of pixels that are compared per frame, of all cameras. At least two and at most six cameras are used."""
TRAINING = {step.timing for step in STEPS.values() if step.trains}


@dataclass(frozen=True)
class Estimate:
    """Time and memory of a run.

    Attributes:
        seconds: Seconds by stage of the whole run, as in `Result`.
        memory: Largest number of bytes of all processes.
        moving: Share of the pixels that change in the first group.
        division: Chapters at a time, and threads of each.
    """

    seconds: dict[str, float]
    memory: int
    moving: float
    division: Division

    @property
    def total(self) -> float:
        """Seconds of the whole run."""
        return sum(self.seconds.values())


def estimate(run: ChapteredRun, division: Division, speed: MachineSpeed, moving: float | None = None) -> Estimate:
    """Estimate a run. The time is within about 30 % if nothing else runs. On a GPU it is only a guess.

    Args:
        run: The run.
        division: Division of the cores, such as `local_processes.division_of` returns it.
        speed: Speed of this machine (`measure_speed`).
        moving: Share of the pixels that change in a group; None measures it on a few images of the first group.

    Raises:
        CaptureError: The capture cannot be read.
    """
    capture, config = run.capture, run.config
    work, pace = _measure(run, speed, moving)
    need = needed_memory(capture, config)
    if len(run.chapters) == 1:
        seconds = pace.job(sequence_plan(work, run.groups, config).seconds, SERIAL_CHAPTER, division.threads)
        return Estimate(seconds, need, work.moving, division)
    cores = division.workers * division.threads
    seconds = pace.job(scene_plan(work, config).seconds, SERIAL_SCENE, cores)
    of_all = sum_seconds(chapter_plan(work, chapter.groups, config).seconds for chapter in run.chapters)
    seconds = sum_seconds([seconds, pace.chapters(of_all, len(run.chapters), division)])
    memory = need if division.workers == 1 else round(division.workers * need + PROCESS)
    return Estimate(seconds, memory, work.moving, division)


@dataclass(frozen=True)
class JobsEstimate:
    """Time and memory of the jobs of a run, each on a machine as fast as this one.

    Attributes:
        scene: Seconds of the shared scene's job; 0 for a video of one chapter, which has none.
        chapter: Seconds of the longest chapter.
        total: Seconds of the whole run.
        at_once: Number of chapters that are made at a time.
    """

    scene: float
    chapter: float
    total: float
    memory: int
    chapters: int
    at_once: int


def estimate_jobs(
    run: ChapteredRun,
    scene_threads: int,
    threads: int,
    at_once: int | None,
    speed: MachineSpeed,
) -> JobsEstimate:
    """Estimate the jobs of a batch system or a cluster.

    Args:
        run: The run.
        scene_threads: Threads of the scene's job.
        threads: Threads of a chapter's job.
        at_once: Number of chapters at a time; None for all.
        speed: Speed of this machine (`measure_speed`).
    """
    capture, config = run.capture, run.config
    work, pace = _measure(run, speed)
    count = len(run.chapters)
    scene, parts = 0.0, [sequence_plan(work, run.groups, config).seconds]
    if count > 1:
        scene = sum(pace.job(scene_plan(work, config).seconds, SERIAL_SCENE, scene_threads).values())
        parts = [chapter_plan(work, chapter.groups, config).seconds for chapter in run.chapters]
    chapter = max(sum(pace.job(part, SERIAL_CHAPTER, threads).values()) for part in parts)
    at_once = min(at_once or count, count)
    total = scene + math.ceil(count / at_once) * chapter
    return JobsEstimate(scene, chapter, total, needed_memory(capture, config), count, at_once)


def _measure(run: ChapteredRun, speed: MachineSpeed, moving: float | None = None) -> tuple[Workload, _Pace]:
    """Return the workload of a run and the pace of this machine. moving: see `estimate`."""
    share = moving_share(run.capture, run.groups[0].count) if moving is None else moving
    work = Workload.of(run.capture, share)
    trained = min(work.megapixels, run.config.training_megapixels or work.megapixels)
    return work, _Pace(speed.training(trained), speed.other, trains_on_gpu=run.device_name != "cpu")


def moving_share(capture: Capture, frames: int) -> float:
    """Return the share of the pixels that change within the first `frames` frames, from a few images of a few cameras."""
    if frames < 2:
        return 0.0
    names = [camera.name for camera in capture.training_cameras]
    count = min(len(names), int(np.clip(LOOKED_AT / (capture.width * capture.height), 2, 6)))
    names = [names[place] for place in np.linspace(0, len(names) - 1, count).round().astype(int)]
    moments = np.unique(np.linspace(0, frames - 1, LOOKS).round().astype(int))
    return float(changed_pixels(np.concatenate([capture.read(int(moment), 1, names) for moment in moments])).mean())


@dataclass(frozen=True)
class _Pace:
    """Conversion from seconds on one thread of the measured machine to seconds on this machine."""

    training: float
    other: float
    trains_on_gpu: bool

    def job(self, seconds: Seconds, serial: float, threads: int) -> Seconds:
        """Return the seconds by stage of a job on several threads. `serial`: share of the work that one thread does."""
        return {stage: self._of(stage, spent, serial, threads) for stage, spent in seconds.items()}

    def chapters(self, seconds: Seconds, count: int, division: Division) -> Seconds:
        """Return the seconds by stage of several chapters, which take `seconds` together."""
        found: Seconds = {}
        for stage, spent in seconds.items():
            one = self._of(stage, spent / count, SERIAL_CHAPTER, 1)
            alone = Division(division.workers, 1 if self._on_gpu(stage) else division.threads)
            found[stage] = chapters_time(one, count, alone)
        return found

    def _of(self, stage: str, seconds: float, serial: float, threads: int) -> float:
        if self._on_gpu(stage):
            return seconds * self.training
        pace = self.training if stage in TRAINING else self.other
        return job_time(seconds * pace, serial, threads)

    def _on_gpu(self, stage: str) -> bool:
        return self.trains_on_gpu and stage in TRAINING


SERIAL_SCENE, SERIAL_CHAPTER = 0.30, 0.28
"""Share of the processor time of a job that only one thread can do. It was measured by `benchmarks/chapters.py`, on basketball 240
pixels wide with two threads, as the time that the main thread takes longer. Three runs gave 0.22 to 0.30 for the scene, 0.24 to
0.29 for chapters."""
WORTH = 1.15
"""Factor by which more workers must be faster to be used. Each worker holds a group's frames, and with fewer workers the first
chapter can be played sooner."""


@dataclass(frozen=True)
class Division:
    """Division of the cores of a machine.

    Attributes:
        workers: Number of chapters at a time.
    """

    workers: int
    threads: int


def divide(cores: int, chapters: int, most: int | None = None) -> Division:
    """Return the division with the fewest workers that is about as fast as any other.

    Args:
        cores: Number of cores.
        chapters: Number of chapters.
        most: Largest number of workers, such as by memory; None for no limit.
    """
    choices = [Division(w, cores // w) for w in range(1, max(1, min(cores, chapters, most or cores)) + 1)]
    times = [chapters_time(1.0, chapters, choice) for choice in choices]
    return next(choice for choice, time in zip(choices, times, strict=True) if time <= WORTH * min(times))


def job_time(one_thread: float, serial: float, threads: int) -> float:
    """Return the time of a job on several threads (Amdahl's law).

    Args:
        one_thread: Time of the job on one thread.
        serial: Share of the work that only one thread can do.
        threads: Number of threads.
    """
    return one_thread * (serial + (1 - serial) / threads)


def chapters_time(one_thread: float, chapters: int, division: Division) -> float:
    """Return the time of chapters on a machine. `one_thread` is the time of a chapter on one thread."""
    return math.ceil(chapters / division.workers) * job_time(one_thread, SERIAL_CHAPTER, division.threads)
