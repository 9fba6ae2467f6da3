"""Estimate of the time and memory of a run, and the division of this machine's cores.

The seconds of the steps also are the plan that the progress display follows. They are fitted to timings of videos 160 to 2576 pixels
wide, most of them in `benchmarks/results.jsonl`. Nearly all totals are within 30 %. Repeated timings of one video differ by as much
from day to day.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.method.cameras.group_input import ENOUGH_SIDE
from splatreel.method.images.change import changed_pixels
from splatreel.method.train.keyframe_trainer import GAINS_EVERY
from splatreel.method.train.training_images import size_ends
from splatreel.run.job import Plan, Seconds, sum_seconds
from splatreel.run.machine_speed import MachineSpeed
from splatreel.run.requirements import PROCESS, needed_memory
from splatreel.run.steps import STEPS
from splatreel.scene.camera import Camera
from splatreel.scene.group import GroupSpan

if TYPE_CHECKING:
    from splatreel.run.jobs import ChapteredRun


COARSE = 0.25
"""Pixels of a half-size image, as a share of the full-size image."""
USUAL_MEGAPIXELS = 0.0576
"""Megapixels (320x180) at which the usual number of points was measured."""
USUAL_MOVING = 0.15
"""Share of changing pixels that is assumed for the progress display, which does not measure it."""
READING_SECONDS = 0.015
"""Seconds to decode a megapixel."""
SCENE_POINTS = 2.0
"""Time of the initial points of several moments, as a multiple of that of one."""
CHAPTER_SHARE = 0.5
"""Time of the first keyframe of a chapter, as a share of that of a video: it trains only points that the shared scene lacks."""
HASHGRID = 3.0
"""Time of an iteration with the hash grid, as a multiple of one with splines."""
CPU_PROGRAM_SHARE = 0.8
"""Time of an iteration as a share of those that the costs were fitted to, which used autograd: 0.71 to 0.73 on two cores, 0.83 to 0.85
on one."""
LIFTING = 280.0
"""Time of the paper's optimization of labels, in iterations of a keyframe."""
GRABCUT = 6.0
"""Seconds that GrabCut takes for a megapixel of masks. SAM2 was never timed."""


@dataclass(frozen=True)
class Workload:
    """Properties of a capture that decide how long each stage takes.

    Attributes:
        megapixels: Megapixels of one image.
        cameras: Number of training cameras.
        moving: Share of the pixels that change within a group, 0..1.
        facing: Length of the mean viewing direction, 0..1: 0 for cameras all around, 1 for cameras that look the same way. A camera
            among cameras that look the same way sees all points.
    """

    megapixels: float
    cameras: int
    moving: float
    facing: float

    @staticmethod
    def of(capture: Capture, moving: float = USUAL_MOVING) -> Workload:
        """Return the workload of a capture.

        Args:
            capture: The capture at the size that is trained on.
            moving: Share of the pixels that change within a group, 0..1.
        """
        cameras = capture.training_cameras
        return Workload(capture.width * capture.height / 1e6, len(cameras), moving, facing(cameras))

    def dynamic(self, config: Config) -> float:
        """Return the expected number of dynamic points, in thousands. It grows with the number of all points."""
        size, crowd = self.megapixels / USUAL_MEGAPIXELS, max(1.0, self.points(config) / self._usual)
        return (1 + 24 * self.moving) * size**0.3 * crowd

    def points(self, config: Config) -> float:
        """Return the expected number of points of the first keyframe, in thousands. Without an opacity price it is the maximum."""
        keyframe = config.keyframe
        most = min(keyframe.max_points, keyframe.points_per_pixel * self.megapixels * 1e6) / 1e3
        if not keyframe.lambda_opacity:
            return max(self._usual, most)
        return min(self._usual, keyframe.max_points / 1e3)

    @property
    def _usual(self) -> float:
        return 22 * (self.megapixels / USUAL_MEGAPIXELS) ** 0.3

    def drawn(self, config: Config) -> float:
        """Return the number of points in thousands, converted to points of the usual size: dense points are smaller on the screen."""
        points = self.points(config)
        size = (self.megapixels / USUAL_MEGAPIXELS) / (points / 22)
        return points * min(1.0, math.sqrt(size))

    def decoded(self, frames: int) -> float:
        """Return the megapixels of all images of a number of frames."""
        return self.cameras * frames * self.megapixels

    def smaller(self) -> float:
        """Return the megapixels of the images that layering and tracking use (`GroupInput.smaller`), at an aspect ratio of 4:3."""
        megapixels = self.megapixels
        while megapixels > 0.75e-6 * ENOUGH_SIDE**2:
            megapixels *= COARSE
        return megapixels

    def training_share(self, config: Config, coarse_share: float) -> float:
        """Return the mean number of pixels of a training iteration, as a share of the full image.

        Args:
            config: Settings of the run.
            coarse_share: Share of the iterations that use half-size images in any case.
        """
        ends = [*size_ends(self.megapixels, coarse_share, config.training_megapixels), 0.0]
        return sum((end - begin) * COARSE**halvings for halvings, (end, begin) in enumerate(pairwise(ends)))

    def full_iteration(self, config: Config, pixels: float = 1.0) -> float:
        """Return the seconds of one keyframe iteration over all points.

        Args:
            config: Settings of the run.
            pixels: Pixels of the iteration, as a share of the full image.
        """
        points = 0.0007 + 0.0005 * self.facing
        return 0.3 * self.megapixels * pixels + points * self.drawn(config)


def facing(cameras: list[Camera]) -> float:
    """Return the length of the mean viewing direction of cameras, 0..1 (see `Workload`)."""
    return float(np.linalg.norm(np.mean([camera.viewmat[2, :3] for camera in cameras], axis=0)))


def _points(work: Workload, frames: int, config: Config) -> float:
    """Return the seconds of the initial points, the check of the poses and the trial of novel views."""
    seconds = 1.0 + work.cameras * (0.07 + 0.45 * work.megapixels)
    if config.check_poses:
        seconds += work.cameras * (0.22 + 0.5 * work.megapixels)
    if config.check_coverage:
        seconds += 3.5
    return seconds


def _exposure(work: Workload, frames: int, config: Config) -> float:
    return 0.007 * work.decoded(frames) * config.even_exposure


def _poses(work: Workload, frames: int, config: Config) -> float:
    return 0.04 * work.cameras * config.check_poses


def _temporal_mean(work: Workload, frames: int, config: Config) -> float:
    return 0.02 * work.decoded(frames) if config.keyframe.temporal_mean else 0.0


def _all_points(work: Workload, config: Config) -> float:
    """Return the seconds of all iterations over all points, many of which use smaller images."""
    keyframe = config.keyframe
    pixels = work.training_share(config, keyframe.coarse_share)
    return keyframe.first_iterations * CPU_PROGRAM_SHARE * work.full_iteration(config, pixels)


def _first_keyframe(work: Workload, frames: int, config: Config) -> float:
    return _all_points(work, config) + _temporal_mean(work, frames, config)


def _chapter_keyframe(work: Workload, frames: int, config: Config) -> float:
    return CHAPTER_SHARE * _all_points(work, config) + _temporal_mean(work, frames, config)


def _keyframe(work: Workload, frames: int, config: Config) -> float:
    """Return the seconds of iterations over dynamic points, few of which compare whole images."""
    megapixels = work.megapixels * work.training_share(config, 0.0)
    iteration = 0.152 / GAINS_EVERY * megapixels + 0.0012 * work.dynamic(config)
    return config.keyframe.refine_iterations * CPU_PROGRAM_SHARE * iteration + _temporal_mean(work, frames, config)


def _layering(work: Workload, frames: int, config: Config) -> float:
    """Return the seconds of flow, light, labels and masks. Large images are halved to 640 pixels for flow, to 0.1 MP for light."""
    if frames < 2:
        return 0.0
    layering, cameras, megapixels = config.layering, work.cameras, work.megapixels
    flow = 1.44 * cameras * min(megapixels, 0.115) * min(layering.flow_frames, frames - 1) / 7
    light = 0.033 * cameras * frames * min(megapixels, 0.077) if layering.relighting else 0.0
    lifting = LIFTING * work.full_iteration(config) if layering.lift == "optimize" else 0.0
    completing = GRABCUT * cameras * megapixels if layering.segment != "none" else 0.0
    return 0.3 + flow + light + lifting + completing


def _layer(work: Workload, frames: int, config: Config) -> float:
    return 0.21 + 0.155 * work.cameras * work.smaller()


def _tracking(work: Workload, frames: int, config: Config) -> float:
    if frames < 2 or not config.group.tracks:
        return 0.0
    return frames * (0.12 * work.cameras * work.smaller() + (0.09 + 0.0011 * work.cameras) * work.dynamic(config))


def _motion(work: Workload, frames: int, config: Config) -> float:
    """Return the seconds of all iterations, and of the static background of each view."""
    if frames < 2:
        return 0.0
    group = config.group
    pixels = work.training_share(config, group.coarse_share)
    iteration = 0.03 * work.megapixels * pixels + 0.0031 * work.dynamic(config) + 0.0014
    iteration *= HASHGRID if group.deformation == "hashgrid" else CPU_PROGRAM_SHARE
    views = 0.152 * work.cameras * math.sqrt(work.megapixels)
    return views + group.iterations_per_frame * frames * iteration


def _encode(work: Workload, frames: int, config: Config) -> float:
    return _layer(work, frames, config) + 0.0097 * work.dynamic(config) * frames


COSTS: dict[str, Callable[[Workload, int, Config], float]] = {
    "points": _points,
    "exposure": _exposure,
    "poses": _poses,
    "scene keyframe": _first_keyframe,
    "first keyframe": _first_keyframe,
    "chapter keyframe": _chapter_keyframe,
    "keyframe": _keyframe,
    "layering": _layering,
    "layer": _layer,
    "tracking": _tracking,
    "motion": _motion,
    "encode": _encode,
}
"""Seconds of each step by its name in `STEPS`: of the workload, the frames of the group with the overlap, and the settings."""


BEFORE_KEYFRAME, AFTER_KEYFRAME = ("exposure", "poses"), ("layering", "layer", "tracking", "motion", "encode")
"""Steps of every group."""


def sequence_plan(work: Workload, spans: Sequence[GroupSpan], config: Config) -> Plan:
    """Return the plan of a video of one chapter."""
    groups = _groups_plan(work, spans, config, "first keyframe")
    return Plan((("points", None, COSTS["points"](work, 1, config)), *groups.steps), groups.reading)


def chapter_plan(work: Workload, spans: Sequence[GroupSpan], config: Config) -> Plan:
    """Return the plan of one chapter of a longer video."""
    return _groups_plan(work, spans, config, "chapter keyframe")


def scene_plan(work: Workload, config: Config) -> Plan:
    """Return the plan of the scene that all chapters share."""
    points = SCENE_POINTS * COSTS["points"](work, 1, config)
    return Plan((("points", None, points), ("scene keyframe", None, COSTS["scene keyframe"](work, 0, config))))


def _groups_plan(work: Workload, spans: Sequence[GroupSpan], config: Config, first: str) -> Plan:
    """Return the plan of groups. `first`: step that trains the keyframe of the first group."""
    keyframes = [first, *("keyframe" for _ in spans[1:])]
    steps = [
        (step, span.index, COSTS[step](work, span.count, config))
        for span, keyframe in zip(spans, keyframes, strict=True)
        for step in (*BEFORE_KEYFRAME, keyframe, *AFTER_KEYFRAME)
    ]
    return Plan(tuple(steps), sum(READING_SECONDS * work.decoded(span.count) for span in spans))


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
        memory: Bytes of a job.
        chapters: Number of chapters.
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


SERIAL_SCENE, SERIAL_CHAPTER, SERIAL_FINISH = 0.30, 0.28, 1.0
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
        threads: Number of threads of each.
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


def chapters_time(one_thread: float, chapters: int, division: Division, machines: int = 1) -> float:
    """Return the time of chapters on machines that are divided alike. `one_thread` is the time of a chapter on one thread."""
    rounds = math.ceil(chapters / (division.workers * machines))
    return rounds * job_time(one_thread, SERIAL_CHAPTER, division.threads)


def run_time(scene: float, chapter: float, finish: float, chapters: int, cores: int, machines: int = 1) -> float:
    """Return the time of a whole run.

    Args:
        scene: Time of the scene's job on one thread.
        chapter: Time of a chapter's job on one thread.
        finish: Time of the last job on one thread.
        chapters: Number of chapters.
        cores: Number of cores of each machine.
        machines: Number of machines.
    """
    division = divide(cores, math.ceil(chapters / machines))
    before, after = job_time(scene, SERIAL_SCENE, cores), job_time(finish, SERIAL_FINISH, cores)
    return before + chapters_time(chapter, chapters, division, machines) + after
