"""A film of Gaussians written as a reel, stretch by stretch."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from splatreel.codec.header import ReelHeader
from splatreel.codec.predictive.precision import COLOR
from splatreel.codec.presentation import Limits
from splatreel.codec.writer import ReelWriter
from splatreel.errors import GaussiansError
from splatreel.progress import Progress
from splatreel.recon.encode.group_writer import PresentationHook, no_presentation
from splatreel.recon.encode.importance import weigh
from splatreel.recon.init.layout import measure
from splatreel.recon.init.limits import limits
from splatreel.scene.camera import Camera, middle_camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.sequence.comparison import Comparison, compare
from splatreel.sequence.frames import Frames
from splatreel.sequence.grouping import StaticLayers, group_of
from splatreel.sequence.identity import Identities
from splatreel.sequence.segments import SegmentBuilder, stretch
from splatreel.sequence.viewpoints import ring, shown

LENGTH = 30
"""Frames of a group, at most."""
NEAR = 0.2
"""What 3DGS does not draw: world units before a camera, and"""
NEAR_SHARE = 0.02
"""at most of the distance at which cameras typically look."""
MOMENTS, PICTURES = 16, 48
"""Times of a group at which it is looked at to see what shows, and pictures in all."""


def header_of(
    first: Gaussians, cameras: list[Camera] | None, up: np.ndarray | None, fps: float, antialias: bool = False
) -> tuple[ReelHeader, Limits | None]:
    """What the reel says before its files, and how far from the cameras views hold, which is not known of a ring.

    first: the first frame. cameras: that the film was made from; None: a ring. up: [3], unit; None: as cameras stand, or -y.
    """
    if not len(first):
        raise GaussiansError("The film's first frame holds no point. Take it away, or export it again.")
    fallback = np.array([0.0, -1.0, 0.0]) if up is None else up
    views = ring(first, fallback) if cameras is None else cameras
    points = shown(first)
    layout = measure(views, points, NEAR)
    if up is not None or cameras is None:
        layout = replace(layout, up=fallback.tolist())
    header = ReelHeader(
        fps=fps,
        group_length=LENGTH,
        overlap=0,
        sh_degree=first.sh_degree,
        bounds=np.array(layout.bounds),
        up=np.array(layout.up),
        camera=views[0 if cameras is None else middle_camera(views)],
        cameras=views,
        near=min(NEAR, NEAR_SHARE * layout.unit),
        antialias=antialias,
    )
    return header, None if cameras is None else limits(cameras, points, layout)


class SequenceEncoder:
    """Writes the frames of a film into a reel. device: where pictures are drawn to see what shows."""

    def __init__(self, writer: ReelWriter, device: torch.device) -> None:
        self.writer, self.device = writer, device
        self.layers = StaticLayers(writer.manifest.sh_degree)

    def write(self, frames: Frames, progress: Progress) -> None:
        """All of them. Raises `GaussiansError` for a frame that cannot be read, or has another degree of view-dependent color."""
        progress.stage("writing the groups", len(frames))
        identities, index, first, length = Identities(), 0, 0, LENGTH
        waiting: list[tuple[Gaussians, np.ndarray]] = []
        while first < len(frames):
            ahead = min(LENGTH, 2 * length)  # where groups are short, looking far ahead is wasted
            for frame in range(first + len(waiting), min(first + ahead, len(frames))):
                points = self._checked(frames, frame)
                waiting.append((points, identities.of(points)))
            builder = stretch(waiting[:ahead])
            length = builder.cut(ahead)
            self._write_group(index, first, builder, length)
            waiting, first, index = waiting[length:], first + length, index + 1
            progress.update(first)

    def _checked(self, frames: Frames, frame: int) -> Gaussians:
        points, degree = frames.read(frame), self.writer.manifest.sh_degree
        if not len(points):
            raise GaussiansError(f"{frames.path}: frame {frame} holds no point.")
        if points.sh_degree != degree:
            raise GaussiansError(
                f"{frames.path}: frame {frame} has view-dependent color of degree {points.sh_degree}, the first one of degree "
                f"{degree}. Write them all alike."
            )
        return points

    def _write_group(self, index: int, first: int, builder: SegmentBuilder, length: int) -> None:
        frames, segments = builder.frames[:length], builder.first(length)
        alive, born, moving = self.layers.split(frames[0], segments)
        points, numbers = frames[0][segments.rows[0, born]], segments.numbers[born]
        rows = segments.rows[:, moving]
        static = Gaussians.concatenate([self.layers.points[alive], points])
        group = group_of(index, first, frames, rows, np.concatenate([alive, np.ones(len(born), bool)]))
        weights = self._importance(group, static)
        _spare_ghosts(weights[: len(moving)], rows.min(0) < 0)
        if len(born):
            _, order = self.writer.add_layer(index, first, points, weights[len(weights) - len(born) :])
            self.layers.add(points[order], numbers[order])
        self.writer.add_group(group, weights[: len(group.dynamic)])

    def _importance(self, group: Group, static: Gaussians) -> np.ndarray:
        """[N, 3], of the moving points and then the static ones: see `weigh`."""
        times = np.linspace(0, group.frames - 1, min(MOMENTS, group.frames))
        moments = (Gaussians.concatenate([group.at(time), static]) for time in times)
        views = math.ceil(PICTURES / len(times))
        reel = self.writer.manifest
        return weigh(moments, list(reel.cameras), reel.near, self.device, reel.antialias, views)


def _spare_ghosts(weights: np.ndarray, passing: np.ndarray) -> None:
    """Raise the importance [M, 3] of points that are not there all the time (passing: [M] bool), in place.

    How exactly an opacity is stored follows from how much the pictures change with the point's color, which is nothing while it is not
    there. But then an error of its opacity shows it as a ghost. Color's class builds upon that of shape.
    """
    if passing.any():
        most = np.quantile(weights[:, : COLOR + 1], 0.9, axis=0)
        weights[passing, : COLOR + 1] = np.maximum(weights[passing, : COLOR + 1], most)


def write_reel(
    frames: Frames,
    writer: ReelWriter,
    progress: Progress,
    device: torch.device,
    holds: Limits | None = None,
    present: PresentationHook = no_presentation,
) -> Comparison:
    """Write a film into a new reel, and compare the two. holds: how far from the cameras views hold. present: adds what is beside."""
    writer.present(replace(writer.manifest.presentation, limits=holds))
    SequenceEncoder(writer, device).write(frames, progress)
    present(writer, None)
    writer.finish()
    return compare(frames, writer.path, progress)
