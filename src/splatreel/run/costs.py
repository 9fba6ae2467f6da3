"""Cost model: the seconds of the steps of a reconstruction on one thread of the machine that was measured, and plans of jobs.

The numbers are fitted to timings of videos 160 to 2576 pixels wide, most of them in `benchmarks/results.jsonl`. Nearly all totals
are within 30 %. Repeated timings of one video differ by as much from day to day.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.method.cameras.group_input import ENOUGH_SIDE
from splatreel.method.train.keyframe_trainer import GAINS_EVERY
from splatreel.method.train.training_images import size_ends
from splatreel.run.job import Plan
from splatreel.scene.camera import Camera
from splatreel.scene.group import GroupSpan

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
