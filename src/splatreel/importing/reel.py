"""Writer that turns a sequence of Gaussians into a reel, group by group."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.progress import Progress
from splatreel.codec.header import ReelHeader
from splatreel.codec.predictive.precision import COLOR
from splatreel.codec.presentation import Limits
from splatreel.codec.writer import ReelWriter
from splatreel.importing.comparison import Comparison, compare
from splatreel.importing.edits import first_points
from splatreel.importing.frames import Frames
from splatreel.importing.grouping import Reach, SegmentBuilder, StaticLayers, group_of, stretch
from splatreel.importing.identity import Identities
from splatreel.importing.viewpoints import ring, visible_positions
from splatreel.method.encode.compression import weigh
from splatreel.method.init.layout import limits, measure
from splatreel.run.output.group_writer import PresentationHook, no_presentation
from splatreel.scene.camera import Camera, middle_camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

LENGTH = 30
"""Maximum number of frames of a group."""
GROUP_BYTES, MOVING_BYTES = 900_000_000, 250
"""Memory for the frames of a group, and what a dynamic point takes in every frame while the group is written."""
NEAR = 0.2
"""Near plane of 3DGS in world units."""
NEAR_SHARE = 0.02
"""Maximum near plane as a share of the typical viewing distance."""
MOMENTS, IMAGES = 16, 48
"""Times per group at which importance is measured, and images in total."""


def header_of(
    first: Gaussians,
    cameras: list[Camera] | None,
    up: np.ndarray | None,
    fps: float,
    antialias: bool = False,
    origin: np.ndarray | None = None,
) -> tuple[ReelHeader, Limits | None]:
    """Return the header of the reel, and the limits of its views, which are unknown for a ring of cameras.

    Args:
        first: First frame that holds points.
        cameras: Training cameras of the sequence; None uses a ring.
        up: Unit up direction, [3]; None derives it from the cameras, or uses -y.
        fps: Frames per second.
        antialias: How splats are drawn, see `render_image`.
        origin: Position of the reel's origin in the sequence, [3]; None is 0, 0, 0.
    """
    fallback = np.array([0.0, -1.0, 0.0]) if up is None else up
    views = ring(first, fallback) if cameras is None else cameras
    points = visible_positions(first)
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
        origin=np.zeros(3) if origin is None else origin,
    )
    return header, None if cameras is None else limits(cameras, points, layout)


def share_equal(before: Gaussians | None, points: Gaussians) -> Gaussians:
    """Return Gaussians that use the arrays of the frame before where these are equal, to save memory."""
    if before is None or len(before) != len(points):
        return points
    equal = {
        name: old for name in Gaussians.ARRAYS if np.array_equal(old := getattr(before, name), getattr(points, name))
    }
    return replace(points, **equal)


class SequenceEncoder:
    """Writer of the frames of a sequence into a reel."""

    def __init__(self, writer: ReelWriter) -> None:
        self.writer = writer
        self._moving: int | None = None

    def write(self, frames: Frames, progress: Progress) -> None:
        """Write all frames.

        Raises:
            GaussiansError: A frame cannot be read, or has another SH degree.
        """
        progress.stage("writing the groups", len(frames))
        self.layers = StaticLayers(self.writer.manifest.sh_degree, Reach.of(first_points(frames), self.writer.config))
        identities, index, first, length = Identities(), 0, 0, LENGTH
        waiting: list[tuple[Gaussians, np.ndarray]] = []
        while first < len(frames):
            before = waiting[-1][0] if waiting else None
            ahead = min(self._affordable(before), 2 * length)  # short groups do not need a long lookahead
            for frame in range(first + len(waiting), min(first + ahead, len(frames))):
                points = before = share_equal(before, self._checked(frames, frame))
                waiting.append((points, identities.of(points)))
                ahead = min(ahead, self._affordable(points))
                if len(waiting) >= ahead:
                    break
            builder = stretch(waiting[:ahead])
            length = builder.cut(ahead)
            self._write_group(index, first, builder, length)
            waiting, first, index = waiting[length:], first + length, index + 1
            progress.update(first)

    def _affordable(self, points: Gaussians | None) -> int:
        """Return how many frames like this one a group may have, so that memory stays bounded."""
        if points is None:
            return LENGTH
        size = sum(getattr(points, name).nbytes for name in Gaussians.ARRAYS)
        moving = len(points) if self._moving is None else min(self._moving, len(points))
        return max(min(LENGTH, GROUP_BYTES // max(size + moving * MOVING_BYTES, 1)), 1)

    def _checked(self, frames: Frames, frame: int) -> Gaussians:
        points, degree = frames.read(frame), self.writer.manifest.sh_degree
        if points.sh_degree > degree:
            raise GaussiansError(
                f"{frames.path}: frame {frame} has view-dependent color of degree {points.sh_degree}, the first one of degree "
                f"{degree}. Export all frames with the same degree."
            )
        return points if points.sh_degree == degree else Gaussians.concatenate([points, Gaussians.empty(degree)])

    def _write_group(self, index: int, first: int, builder: SegmentBuilder, length: int) -> None:
        frames, segments = builder.frames[:length], builder.first(length)
        alive, born, moving = self.layers.split(frames, segments)
        shells = self.layers.reach.shells(frames[0][segments.rows[0, born]])
        born, shells = born[order := np.argsort(shells, kind="stable")], shells[order]
        points, numbers = frames[0][segments.rows[0, born]], segments.numbers[born]
        rows = segments.rows[:, moving]
        self._moving = len(moving)
        static = Gaussians.concatenate([self.layers.points[alive], points])
        group = group_of(index, first, frames, rows, np.concatenate([alive, np.ones(len(born), bool)]))
        weights = self._importance(group, static)
        _raise_importance_of_absent_points(weights[: len(moving)], rows.min(0) < 0)
        born_weights = weights[len(weights) - len(born) :]
        for shell in np.unique(shells):
            some = np.flatnonzero(shells == shell)
            _, order = self.writer.add_layer(index, first, points[some], born_weights[some])
            self.layers.add(points[some[order]], numbers[some[order]])
        self.writer.add_group(group, weights[: len(group.dynamic)])

    def _importance(self, group: Group, static: Gaussians) -> np.ndarray:
        """Return the importance [N, 3] of the dynamic points, then the static ones, see `weigh`."""
        times = np.linspace(0, group.frames - 1, min(MOMENTS, group.frames))
        moments = (Gaussians.concatenate([group.at(time), static]) for time in times)
        views = math.ceil(IMAGES / len(times))
        reel = self.writer.manifest
        return weigh(moments, list(reel.cameras), reel.near, reel.antialias, views)


def _raise_importance_of_absent_points(weights: np.ndarray, passing: np.ndarray) -> None:
    """Raise the importance [M, 3] of points that are absent at times (passing: [M] bool), in place.

    The precision of an opacity follows from the effect of the point's color on the images, which is zero while the
    point is absent. An error of its opacity would then show as a ghost. The class of color is relative to that of
    shape.
    """
    if passing.any():
        most = np.quantile(weights[:, : COLOR + 1], 0.9, axis=0)
        weights[passing, : COLOR + 1] = np.maximum(weights[passing, : COLOR + 1], most)


def write_reel(
    frames: Frames,
    writer: ReelWriter,
    progress: Progress,
    holds: Limits | None = None,
    present: PresentationHook = no_presentation,
) -> Comparison:
    """Write a sequence into a new reel and compare the two.

    Args:
        frames: Source sequence.
        writer: Writer of the new reel.
        progress: Progress display.
        holds: Limits of the views.
        present: Function that adds further presentation.
    """
    writer.present(replace(writer.manifest.presentation, limits=holds))
    SequenceEncoder(writer).write(frames, progress)
    present(writer, None)
    writer.finish()
    return compare(frames, writer.path, progress, writer.manifest.antialias)
