"""Finished run that all baselines start from: its cameras, its images, its first keyframe and its time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from splatreel.base.errors import ReconstructionError, UsageError
from splatreel.capture.base import Capture
from splatreel.codec.header import ReelHeader
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config, EncodeConfig
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.cameras.exposure import Exposure, remove_exposure
from splatreel.method.cameras.rig import Rig
from splatreel.method.init.layout import Layout
from splatreel.method.train.render import View
from splatreel.method.train.training_images import TrainingImages
from splatreel.run.run_logs import read_history
from splatreel.run.steps import EXPOSURE, KEYFRAME, STEPS, restored_rig
from splatreel.run.store import Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import GroupSpan, group_spans


@dataclass(frozen=True)
class SharedStart:
    """Finished run of ours on a capture.

    Every baseline has the cameras of this run with their corrected poses and color gains, its images without changes of
    exposure, and its first keyframe.

    Attributes:
        capture: The capture.
        run: Output folder of the run.
        config: Settings of the run.
    """

    capture: Capture
    run: Path
    config: Config

    @property
    def store(self) -> Store:
        """Checkpoints of the run."""
        return Store(self.run / "work")

    @cached_property
    def spans(self) -> list[GroupSpan]:
        """Groups of the run."""
        group = self.config.group
        return group_spans(self.capture.frames, group.length, group.overlap)

    @cached_property
    def rig(self) -> Rig:
        """Training cameras as the first group of the run left them."""
        return restored_rig(Rig.of(self.capture.training_cameras), self.store.group(0), self.spans[0].own)

    @cached_property
    def layout(self) -> Layout:
        """Measures of the scene."""
        layout = self.store.layout()
        if layout is None:
            raise ReconstructionError(f"{self.store.work}: holds no finished run. Reconstruct the capture first.")
        return layout

    @cached_property
    def keyframe(self) -> Gaussians:
        """Points of the first frame.

        Raises:
            UsageError: The run has several chapters, which have no common first keyframe.
        """
        found = KEYFRAME.load(self.store.group(0))
        if found is None:
            raise UsageError(
                f"{self.run}: has no first keyframe to start baselines from. Use fewer frames, or --set chapter_frames=0."
            )
        return found.points

    @cached_property
    def header(self) -> ReelHeader:
        """Header of the run's reel."""
        return self.store.header()[0]

    @property
    def max_points(self) -> int:
        """Maximum number of points of a frame: that of our first keyframe, but room for half as many as the keyframe has."""
        keyframe = self.config.keyframe
        most = min(keyframe.max_points, round(keyframe.points_per_pixel * self.capture.width * self.capture.height))
        return max(most, len(self.keyframe) * 3 // 2)

    def gains(self) -> CameraGains:
        """Return the color gains of the cameras, which may be refined."""
        gains = CameraGains(len(self.rig.cameras), self.config.correct_colors)
        gains.load(self.rig.gains)
        return gains

    def training_images(self, frame: int) -> TrainingImages:
        """Return the training images of one frame, without changes of exposure and light."""
        images = self.capture.read(frame, 1, self.rig.names)
        exposure, place = self._exposure(frame)
        if exposure is not None:
            one = Exposure(exposure.change[place : place + 1], exposure.light[place : place + 1])
            remove_exposure(images, one)
        absent = self.capture.missing(frame, 1, self.rig.names)[0]
        unknown = None
        if absent.any() and not absent.all():
            unknown = np.broadcast_to(absent[:, None, None], images.shape[1:4])[None]
        views = [View.of(c, self.config.antialias, self.layout) for c in self.rig.cameras]
        return TrainingImages(images, views, self.layout.near, self.layout.unit, unknown)

    def light(self, first: int, count: int) -> np.ndarray | None:
        """Return the factors [count, 3] of the light from frame `first` on, as in `Group.light`; None if it never changes."""
        found = np.zeros((count, 3), np.float32)
        for row in range(count):
            exposure, place = self._exposure(first + row)
            if exposure is not None:
                found[row] = exposure.light[place]
        return np.exp(found) if found.any() else None

    @cached_property
    def seconds(self) -> float:
        """Seconds of all stages of the run."""
        return sum(self.store.seconds().values())

    @cached_property
    def keyframe_seconds(self) -> float:
        """Seconds of training the first keyframe; those of all keyframes if the run has no history."""
        stages = read_history(self.store.work).stages
        trained = sum(stage.seconds for stage in stages if stage.name == STEPS["first keyframe"].text)
        return trained or self.store.seconds().get("keyframe", 0.0)

    @property
    def shared_seconds(self) -> float:
        """Seconds of the run up to its first keyframe, which the baselines share."""
        return self.store.seconds().get("points", 0.0) + self.keyframe_seconds

    def open_writer(self, reel: Path, length: int, encode: EncodeConfig, sh_degree: int | None = None) -> ReelWriter:
        """Return the writer of a baseline's reel, whose groups have `length` frames and no overlap."""
        _, limits = self.store.header()
        degree = self.header.sh_degree if sh_degree is None else sh_degree
        header = replace(self.header, group_length=length, overlap=0, sh_degree=degree)
        writer = ReelWriter(reel, header, config=encode)
        writer.present(replace(writer.manifest.presentation, limits=limits))
        return writer

    def _exposure(self, frame: int) -> tuple[Exposure | None, int]:
        """Return the exposures of the group of a frame, and the frame's place in the group."""
        span = next(span for span in self.spans if frame < span.first + span.own)
        return EXPOSURE.load(self.store.group(span.index)), frame - span.first
