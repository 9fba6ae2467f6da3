"""The method: reconstruction of one group of frames (paper section 4), in the order of the paper's sections.

`run/groups.py` calls `reconstruct_group` for one group after the other. `run` executes each step: it measures the time, shows the
progress, saves the result, and in a continued run loads the result instead of computing it (`run/steps.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol, TypeAlias, TypeVar, TypeVarTuple

import numpy as np

from splatreel.base.progress import Progress
from splatreel.config import Config
from splatreel.method.cameras.exposure import (
    Exposure,
    at_next_keyframe,
    measure_exposure,
    remove_exposure,
    report_exposure,
)
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.rig import Poses, Rig, check_later_poses, report_offsets
from splatreel.method.cameras.time_offsets import LearnedOffsets
from splatreel.method.encode.compression import Coding, compress_group, compress_layer
from splatreel.method.layering.labels import Layers, find_layers
from splatreel.method.tracking.tracking import GroupStart, VelocityPrior, track
from splatreel.method.train.keyframe_trainer import KeyframeResult
from splatreel.method.train.stages import (
    KeyframeWatch,
    refine_keyframe,
    start_chapter,
    train_first_keyframe,
    train_group,
)
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group

Arguments = TypeVarTuple("Arguments")
Found = TypeVar("Found")


@dataclass(frozen=True)
class FirstGroup:
    """State before the first group of a video: `seeds` are initial points [P, 3] and their colors [P, 3] 0..1."""

    keyframe_step: ClassVar[str] = "first keyframe"
    rig: Rig
    static: StaticPoints
    seeds: tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class ChapterStart:
    """State before the first group of a chapter: the static points of the scene that all chapters share."""

    keyframe_step: ClassVar[str] = "chapter keyframe"
    rig: Rig
    static: StaticPoints


@dataclass(frozen=True)
class NextGroup:
    """State at the keyframe of a group, passed on by the group before it.

    Attributes:
        static: All static points so far, decoded.
        dynamic: Dynamic points of the group before, deformed to the keyframe.
        velocity: Motion of `dynamic` at the keyframe; None if it is unknown.
        reference: Images [C, H, W, 3] uint8 of the last frame before a gap, which the exposures of `rig` belong to. None without
            a gap: the exposures belong to the keyframe.
        retired: The points of `static` before encoding, if their layers end at this group; None otherwise.
    """

    keyframe_step: ClassVar[str] = "keyframe"
    rig: Rig
    static: StaticPoints
    dynamic: Gaussians
    velocity: VelocityPrior | None = None
    reference: np.ndarray | None = None
    retired: Gaussians | None = None


Start: TypeAlias = FirstGroup | ChapterStart | NextGroup
"""State that a group starts from."""


def reconstruct_group(
    data: GroupInput, start: Start, config: Config, coding: Coding, run: Run, watch: KeyframeWatch
) -> NextGroup:
    """Reconstruct one group of frames.

    `data` holds its images, which are changed. `start` is the state that the group before passed on.
    """
    # The paper assumes constant exposures and correct poses.
    corrected = correct_cameras(data, start, config, run)

    # Section 4: the keyframe. Static points of earlier groups are frozen.
    keyframe = find_keyframe(corrected, start, config, run, watch)
    views = replace(corrected, rig=replace(corrected.rig, gains=keyframe.gains))
    static = start.static if keyframe.alive is None else start.static.with_alive(keyframe.alive)

    # Section 4.1: motion layering. New static points are encoded at once, so that later steps make up for the loss.
    layers = run("layering", find_layers, views, keyframe.points, static, config.layering)
    layers, static = renew_static(layers, static, start.retired if isinstance(start, NextGroup) else None)
    tracks = GroupStart(Gaussians.concatenate([layers.dynamic, layers.relit.points]))
    if len(layers.new_static):
        layer = run("layer", compress_layer, views, layers.new_static, tracks.dynamic, static.living, coding)
        static = static.with_layer(layer.decoded)

    # Section 4.2: motion. In the paper the points start at rest, here on tracks of optical flow.
    if config.group.tracks and views.span.count > 1:
        tracks = run("tracking", track_points, views, layers, static, start, config, run.progress)
        static = static if tracks.departed is None else static.without(tracks.departed)
    motion = run("motion", train_group, views, tracks, static, config, run.progress)
    rig = add_offsets(views.rig, motion.time_offsets, run.progress)

    # Section 4.3: compression.
    group = motion.as_group(views.span, views.light)
    run("encode", compress_group, views, group, static, coding)
    return hand_over(rig, static, group, views.span.own)


def correct_cameras(data: GroupInput, start: Start, config: Config, run: Run) -> GroupInput:
    """Remove changes of exposure and light from the images, and correct the poses of cameras that were moved.

    A subject alone shows neither: it moves, and has few features.
    """
    subject_only, corrected = bool(data.layout.backgrounds), data
    if config.even_exposure and not subject_only:
        exposure = run("exposure", measure_exposures, data, start)
        corrected = run("even exposures", remove_exposures, data, exposure, run.progress)
    if config.check_poses and not (subject_only and data.span.index):
        poses = run("poses", check_poses, corrected, run.progress)
        corrected = replace(corrected, rig=corrected.rig.with_poses(poses))
    return corrected


def measure_exposures(data: GroupInput, start: Start) -> Exposure:
    """Compare all frames with the keyframe, with the plates of a chapter, or with the frame before a gap."""
    if data.plates is not None:
        return measure_exposure(data.rig.evened(), data.images, data.plates)
    return measure_exposure(data.rig, data.images, start.reference if isinstance(start, NextGroup) else None)


def remove_exposures(data: GroupInput, exposure: Exposure, progress: Progress) -> GroupInput:
    """Even the images out in place. Return the group with its light, and with the exposures of the rig at the next keyframe."""
    report_exposure(data.rig, exposure, progress)
    remove_exposure(data.images, exposure)
    rig = at_next_keyframe(data.rig, exposure, data.span.own)
    return replace(data, rig=rig, light=exposure.light_factors)


def check_poses(data: GroupInput, progress: Progress) -> Poses:
    """Correct the poses of cameras that were moved since the group before, by the first and the middle frame."""
    return check_later_poses(data.rig, data.images[[0, len(data.images) // 2]], progress)


def find_keyframe(data: GroupInput, start: Start, config: Config, run: Run, watch: KeyframeWatch) -> KeyframeResult:
    """Train the keyframe, unless nothing moves in front of the static points."""
    if isinstance(start, NextGroup) and not len(start.dynamic):
        return KeyframeResult(start.dynamic, data.gains)
    return run(start.keyframe_step, train_keyframe, data, start, config, run.progress, watch)


def train_keyframe(
    data: GroupInput, start: Start, config: Config, progress: Progress, watch: KeyframeWatch
) -> KeyframeResult:
    """Train all points of a video's first group, new points of a chapter's, or dynamic points of any other."""
    match start:
        case FirstGroup():
            found = train_first_keyframe(data, *start.seeds, config, progress, watch=watch.show)
        case ChapterStart():
            found = start_chapter(data, start.static, config, progress)
        case NextGroup():
            found = refine_keyframe(data, start.dynamic, start.static, config, progress)
    found.points.check_finite(f"Keyframe {data.span.index}")
    watch.finish(found.points)
    return found


def renew_static(layers: Layers, static: StaticPoints, retired: Gaussians | None) -> tuple[Layers, StaticPoints]:
    """Return the layers with all new static points, and the old static points that stay static.

    `retired` are the static points before encoding, if their layers end at this group. Those that stay static are then
    new static points, and no older ones remain.
    """
    if retired is None:
        return layers, static.with_alive(layers.alive)
    new_static = Gaussians.concatenate([retired[layers.alive], layers.new_static])
    return replace(layers, new_static=new_static), StaticPoints(static.points[:0], np.zeros(0, bool))


def track_points(
    data: GroupInput, layers: Layers, static: StaticPoints, start: Start, config: Config, progress: Progress
) -> GroupStart:
    """Track the dynamic points, at first by their velocity in the group before."""
    before = start.velocity if isinstance(start, NextGroup) else None
    velocities = before and before.at(layers.dynamic.means, data.unit)
    return track(data, layers.dynamic, layers.relit, static, velocities, config.layering, progress)


def add_offsets(rig: Rig, learned: LearnedOffsets | None, progress: Progress) -> Rig:
    """Return the rig with the time offsets at the end of a group, and report them; the same rig if none are learned."""
    if learned is None:
        return rig
    found = rig.with_offsets(learned.values)
    report_offsets(found, learned, progress)
    return found


def hand_over(rig: Rig, static: StaticPoints, group: Group, own: int) -> NextGroup:
    """Return the state at the next keyframe, with the dynamic points deformed to it (section 4).

    `own` is the number of the group's frames without the overlap.
    """
    return NextGroup(rig, static.with_alive(group.alive), group.at(own), VelocityPrior.of(group, own))


class Run(Protocol):
    """Execution of the steps of a group."""

    @property
    def progress(self) -> Progress:
        """Display of the progress."""
        ...

    def __call__(self, step: str, compute: Callable[[*Arguments], Found], *arguments: *Arguments) -> Found:
        """Return the result of a step, loaded or computed from the arguments. `step`: its name in `run/steps.py`."""
        ...
