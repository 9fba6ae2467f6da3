"""The method: reconstruction of one group of frames (paper section 4), in the order of the paper's sections.

`run/groups.py` calls `reconstruct_group` for one group after the other. `run` executes each step: it measures the time, shows the
progress, saves the result, and in a continued run loads the result instead of computing it (`run/step_run.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar, TypeVarTuple

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
from splatreel.method.encode.compression import Coding, compress_group, compress_layer
from splatreel.method.layering.labels import Layers, find_layers
from splatreel.method.tracking.tracking import GroupStart, VelocityPrior, track
from splatreel.method.train.chapter_keyframe import start_chapter
from splatreel.method.train.keyframe_trainer import KeyframeResult
from splatreel.method.train.stages import KeyframeWatch, refine_keyframe, train_first_keyframe, train_group
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group

Arguments = TypeVarTuple("Arguments")
Found = TypeVar("Found")


def reconstruct_group(
    data: GroupInput, start: Handover, config: Config, coding: Coding, run: Run, watch: KeyframeWatch
) -> Handover:
    """Reconstruct one group of frames.

    Args:
        data: Images and cameras of the group. The images are changed.
        start: State at the keyframe that the group before passed on.
        config: Settings.
        coding: Encoder of layers and groups.
        run: Executes the steps.
        watch: Receives the points of the first keyframe while they train.

    Returns:
        State at the next keyframe.
    """
    span, static, progress = data.span, start.static, run.progress

    # Cameras: the paper assumes constant exposures and correct poses. A subject alone shows neither: it moves, and has few features.
    subject_only = bool(data.layout.backgrounds)
    if config.even_exposure and not subject_only:
        exposure = run("exposure", measure_exposures, data, start)
        data = run("even exposures", remove_exposures, data, exposure, progress)
    if config.check_poses and not (subject_only and span.index):
        data = replace(data, rig=data.rig.with_poses(run("poses", check_poses, data, progress)))

    # Section 4: the keyframe. Static points of earlier groups are frozen.
    keyframe = unchanged_keyframe(data, start)
    if keyframe is None:
        keyframe = run(start.keyframe_step, train_keyframe, data, start, config, progress, watch)
    data = replace(data, rig=replace(data.rig, gains=keyframe.gains))
    static = static if keyframe.alive is None else static.with_alive(keyframe.alive)

    # Section 4.1: motion layering. New static points are encoded at once, so that later steps make up for the loss.
    layers = run("layering", find_layers, data, keyframe.points, static, config.layering)
    layers, static = renew_static(layers, static, start.retired)
    tracks = GroupStart(Gaussians.concatenate([layers.dynamic, layers.relit.points]))
    if len(layers.new_static):
        layer = run("layer", compress_layer, data, layers.new_static, tracks.dynamic, static.living, coding)
        static = static.with_layer(layer.decoded)

    # Section 4.2: motion. In the paper the points start at rest, here on tracks of optical flow.
    if config.group.tracks and span.count > 1:
        tracks = run("tracking", track_points, data, layers, static, start, config, progress)
        static = static if tracks.departed is None else static.without(tracks.departed)
    motion = run("motion", train_group, data, tracks, static, config, progress)
    if motion.time_offsets is not None:
        data = replace(data, rig=data.rig.with_offsets(motion.time_offsets.values))
        report_offsets(data.rig, motion.time_offsets, progress)

    # Section 4.3: compression.
    group = motion.as_group(span, data.light)
    run("encode", compress_group, data, group, static, coding)
    return hand_over(data.rig, static, group, span.own)


def measure_exposures(data: GroupInput, start: Handover) -> Exposure:
    """Compare all frames with the keyframe, with the plates of a chapter, or with the frame before a gap."""
    if data.plates is not None:
        return measure_exposure(data.rig.evened(), data.images, data.plates)
    return measure_exposure(data.rig, data.images, start.reference)


def remove_exposures(data: GroupInput, exposure: Exposure, progress: Progress) -> GroupInput:
    """Even the images out in place. Return the group with its light, and with the exposures of the rig at the next keyframe."""
    report_exposure(data.rig, exposure, progress)
    remove_exposure(data.images, exposure)
    rig = at_next_keyframe(data.rig, exposure, data.span.own)
    return replace(data, rig=rig, light=exposure.light_factors)


def check_poses(data: GroupInput, progress: Progress) -> Poses:
    """Correct the poses of cameras that were moved since the group before, by the first and the middle frame."""
    return check_later_poses(data.rig, data.images[[0, len(data.images) // 2]], progress)


def unchanged_keyframe(data: GroupInput, start: Handover) -> KeyframeResult | None:
    """Return the keyframe of a group without dynamic points, which needs no training; None for all others."""
    if start.dynamic is None or len(start.dynamic):
        return None
    return KeyframeResult(start.dynamic, data.gains)


def train_keyframe(
    data: GroupInput, start: Handover, config: Config, progress: Progress, watch: KeyframeWatch
) -> KeyframeResult:
    """Train the keyframe: all points in a video's first group, new points in a chapter's, dynamic points in all others."""
    if start.seeds is not None:
        found = train_first_keyframe(data, *start.seeds, config, progress, watch=watch.show)
    elif start.dynamic is None:
        found = start_chapter(data, start.static, config, progress)
    else:
        found = refine_keyframe(data, start.dynamic, start.static, config, progress)
    found.points.check_finite(f"Keyframe {data.span.index}")
    watch.finish(found.points)
    return found


def renew_static(layers: Layers, static: StaticPoints, retired: Gaussians | None) -> tuple[Layers, StaticPoints]:
    """Return the layers with all new static points, and the old static points that stay static.

    Args:
        layers: Result of layering.
        static: All static points so far.
        retired: The same points before encoding, if their layers end at this group. Those that stay static are then new
            static points, and no older ones remain.
    """
    if retired is None:
        return layers, static.with_alive(layers.alive)
    new_static = Gaussians.concatenate([retired[layers.alive], layers.new_static])
    return replace(layers, new_static=new_static), StaticPoints(static.points[:0], np.zeros(0, bool))


def track_points(
    data: GroupInput, layers: Layers, static: StaticPoints, start: Handover, config: Config, progress: Progress
) -> GroupStart:
    """Track the dynamic points, at first by their velocity in the group before."""
    velocities = start.velocity and start.velocity.at(layers.dynamic.means, data.unit)
    return track(data, layers.dynamic, layers.relit, static, velocities, config.layering, progress)


def hand_over(rig: Rig, static: StaticPoints, group: Group, own: int) -> Handover:
    """Return the state at the next keyframe, with the dynamic points deformed to it (section 4).

    Args:
        rig: Cameras as they are known so far.
        static: All static points so far.
        group: The finished group.
        own: Number of its frames without the overlap.
    """
    velocity = VelocityPrior.of(group, own)
    return Handover(rig, static.with_alive(group.alive), group.at(own), velocity=velocity)


@dataclass(frozen=True)
class Handover:
    """State at the keyframe of a group, passed on by the group before it.

    Attributes:
        rig: Cameras as they are known so far.
        static: All static points so far, decoded.
        dynamic: Dynamic points of the group before, deformed to the keyframe (section 4). None before the first group of a video
            or of a chapter.
        seeds: Initial points [P, 3] and their colors [P, 3] 0..1, before the first group of a video; None for all other groups.
        velocity: Motion of `dynamic` at the keyframe; None if it is unknown.
        reference: Images [C, H, W, 3] uint8 of the last frame before a gap, which the exposures of `rig` belong to. None without
            a gap: the exposures belong to the keyframe.
        retired: The points of `static` before encoding, if their layers end at this group; None otherwise.
    """

    rig: Rig
    static: StaticPoints
    dynamic: Gaussians | None = None
    seeds: tuple[np.ndarray, np.ndarray] | None = None
    velocity: VelocityPrior | None = None
    reference: np.ndarray | None = None
    retired: Gaussians | None = None

    @property
    def keyframe_step(self) -> str:
        """Name of the step that trains the keyframe."""
        if self.seeds is not None:
            return "first keyframe"
        return "chapter keyframe" if self.dynamic is None else "keyframe"


class Run(Protocol):
    """Execution of the steps of a group."""

    @property
    def progress(self) -> Progress:
        """Display of the progress."""
        ...

    def __call__(self, step: str, compute: Callable[[*Arguments], Found], *arguments: *Arguments) -> Found:
        """Return the result of a step, loaded or computed from the arguments. `step`: its name in `run/steps.py`."""
        ...
