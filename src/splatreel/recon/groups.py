"""The way of the groups, one after the other: each starts from what the one before hands over."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splatreel.capture.base import Capture
from splatreel.capture.prefetch import FramePrefetcher
from splatreel.recon.cameras.rig import Rig, tell_offsets
from splatreel.recon.encode.group_output import Output
from splatreel.recon.init.layout import Layout
from splatreel.recon.layering.labels import Layers
from splatreel.recon.layering.velocity_prior import VelocityPrior
from splatreel.recon.run.job import Job
from splatreel.recon.run.store import restored_rig
from splatreel.recon.stages import (
    chapter_start,
    keyframe,
    layering,
    look_at_group,
    motion,
    publish_group,
    publish_layer,
    tracking,
)
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.spans import GroupSpan
from splatreel.scene.static_points import StaticPoints


@dataclass(frozen=True)
class Handover:
    """What a group hands to the next, at whose keyframe it is. dynamic: the points that moved. velocity: how they were going there.

    rig: what is known of the cameras. static: all static points so far. The first group finds neither points nor velocity. The first
    one of a chapter (begins) finds the static points that all chapters share; what is there beside them is not known yet.
    plates: [C, H, W, 3] uint8, in a chapter, the pictures that the shared points were made from. Exposures and light are measured
    against them, since what changes slowly is not to be seen within a group.
    trained: all static points before they were encoded, where those that are still there shall be written anew with the next group.
    reference: [C, H, W, 3] uint8, the pictures for which the rig's exposures are, where that is not the next keyframe.
    """

    rig: Rig
    static: StaticPoints
    dynamic: Gaussians
    velocity: VelocityPrior | None = None
    plates: np.ndarray | None = None
    begins: bool = False
    trained: Gaussians | None = None
    reference: np.ndarray | None = None


def reconstruct_groups(job: Job, capture: Capture, layout: Layout, before: Handover, output: Output) -> None:
    """The groups of a job, from the first that is not finished; the next one's frames are decoded ahead.

    before: what the first of them starts from.
    """
    finished = min(job.store.finished_groups(job.spans[0].index), len(job.spans))
    for place, span in enumerate(job.spans[:finished]):
        before = restore_group(job, span, before)
        output.restore(span.index, last=place + 1 == finished)
    todo = job.spans[finished:]
    with FramePrefetcher(capture, before.rig.names, [(span.first, span.count) for span in todo]) as stretches:
        for span, frames in zip(todo, stretches, strict=True):
            before = reconstruct_group(job, span, frames, before, layout, output)


def reconstruct_group(
    job: Job, span: GroupSpan, frames: np.ndarray, before: Handover, layout: Layout, output: Output
) -> Handover:
    """The way of a group: a keyframe, what of it rests and what moves, where that goes, and how exactly; then it is published.

    frames: [T, C, H, W, 3] uint8, given up.
    """
    if before.plates is None:
        data, rig = look_at_group(job, span, frames, before.rig, layout, before.reference)
    else:
        data, rig = look_at_group(job, span, frames, before.rig.evened(), layout, before.plates)
    if before.begins:
        first = chapter_start(job, data, before.static)
        static = before.static.with_alive(first.alive)
    else:
        first, static = keyframe(job, data, before.dynamic, before.static), before.static
    data, rig = replace(data, gains=first.gains), replace(rig, gains=first.gains)
    layers = layering(job, data, first.points, static)
    if before.trained is not None:
        layers, static = renewed(layers, before.trained), StaticPoints.none(job.config.keyframe.sh_degree)
    static = publish_layer(job, data, layers, static, output)
    start = tracking(job, data, layers, static, before.velocity)
    if start.departed is not None:
        static = static.without(start.departed)
    found = motion(job, data, start, static)
    if job.config.group.time_offsets:
        job.store.group(span.index).save_time_offsets(found.time_offsets.values)
        rig = rig.timed(found.time_offsets.values)
        tell_offsets(rig, found.time_offsets, job.progress)
    group = Group(span.index, span.first, found.dynamic, found.dx, found.dq, found.alive, found.shade, data.light)
    with job.timed("encode"):
        job.say(span, "writing it for players", 1, job.plan.moved(span.index))
        publish_group(job, data, group, static, output)
        job.progress.update(1)
    return hand_over(span, rig, static, group, before.plates)


def renewed(layers: Layers, trained: Gaussians) -> Layers:
    """All that rests as points that are new. trained: the static points of before, of which `layers` says which rest."""
    settled = Gaussians.concatenate([trained[layers.alive], layers.settled])
    return replace(layers, settled=settled, alive=np.zeros(0, bool))


def restore_group(job: Job, span: GroupSpan, before: Handover) -> Handover:
    """What a finished group handed over, from the checkpoints and what it found."""
    store = job.store.group(span.index)
    layer, static = store.layer(), before.static
    if layer is not None:
        static = static.with_layer(layer.decoded)
    rig = restored_rig(before.rig, store, span.own)
    return hand_over(span, rig, static, store.group().group, before.plates)


def hand_over(
    span: GroupSpan, rig: Rig, static: StaticPoints, group: Group, plates: np.ndarray | None = None
) -> Handover:
    """At the next keyframe: the dynamic points, deformed there (paper section 4)."""
    velocity = VelocityPrior.of(group, span.own)
    return Handover(rig, static.with_alive(group.alive), group.at(span.own), velocity, plates)
