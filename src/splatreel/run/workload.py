"""Cost model: the seconds that parts of a reconstruction take on one thread of the machine that was measured.

The numbers are fitted to timings of videos 160 to 2576 pixels wide, most of them in `benchmarks/results.jsonl`. Nearly all totals
are within 30 %. Repeated timings of one video differ by as much from day to day.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.method.cameras.group_input import ENOUGH_SIDE
from splatreel.method.train.pictures import size_ends
from splatreel.scene.camera import Camera

COARSE = 0.25
"""Pixels of a half-size image, as a share of the full-size image."""
USUAL_MEGAPIXELS = 0.0576
"""Megapixels (320x180) at which the usual number of points was measured."""
USUAL_MOVING = 0.15
"""Share of changing pixels that is assumed for the progress display, which does not measure it."""

Seconds = dict[str, float]
"""Seconds by the name of a stage."""


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
        """Return the megapixels of all images of so many frames."""
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


def sum_seconds(parts: Iterable[Seconds]) -> Seconds:
    """Return the sum of several parts, stage by stage."""
    found: Seconds = {}
    for part in parts:
        for stage, seconds in part.items():
            found[stage] = found.get(stage, 0.0) + seconds
    return found
