"""The whole way from a capture to a reel: group after group, published as they finish, continued where a run was cut off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from splatreel.capture.base import Capture
from splatreel.capture.prefetch import FramePrefetcher
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config
from splatreel.progress import Progress, Silent
from splatreel.recon.cameras.rig import Rig, tell_offsets
from splatreel.recon.encode.publisher import Present, Publisher, nothing_more
from splatreel.recon.encode.sound import hear
from splatreel.recon.init.layout import Layout
from splatreel.recon.layering.velocity_prior import VelocityPrior
from splatreel.recon.preparation import open_reel, prepare
from splatreel.recon.run.device import pick_device
from splatreel.recon.run.job import Job
from splatreel.recon.run.memory import check_memory
from splatreel.recon.run.requirements import check_capture
from splatreel.recon.run.run_lock import RunLock
from splatreel.recon.run.store import Store, restored_rig
from splatreel.recon.stages import (
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
from splatreel.scene.spans import GroupSpan, group_spans
from splatreel.scene.static_points import StaticPoints


@dataclass(frozen=True)
class Result:
    """Where a reconstruction lies. seconds: per stage, summed over the groups and over interrupted runs."""

    reel: Path
    work: Path
    seconds: dict[str, float]
    device: str


@dataclass(frozen=True)
class Handover:
    """What a group hands to the next, at whose keyframe it is. dynamic: the points that moved. velocity: how they were going there.

    rig: what is known of the cameras. static: all static points so far. The first group finds neither points nor velocity.
    """

    rig: Rig
    static: StaticPoints
    dynamic: Gaussians
    velocity: VelocityPrior | None = None


def reconstruct(
    capture: Capture,
    out: Path,
    config: Config,
    *,
    sound: str = "auto",
    device: str = "auto",
    progress: Progress | None = None,
    present: Present = nothing_more,
) -> Result:
    """Reconstruct a capture into OUT/reel, with checkpoints in OUT/work; the same call continues an interrupted run.

    sound: auto (the best of the cameras'), none, the name of a camera, or a file. device: auto, cpu or cuda. present: adds what is
    there beside the points. Raises `ReconstructionError` when OUT belongs to another capture or configuration or is in use, or a
    checkpoint is damaged, `UsageError` for a device that is not there, `ReelError` where the disk refuses, and what the capture raises
    for frames or sound that cannot be read. What is finished stays, whatever is raised.
    """
    check_capture(capture)
    check_memory(capture, config.group.length + config.group.overlap)
    chosen, progress = pick_device(device), progress or Silent()
    with RunLock(Path(out), capture, config, sound) as lock:
        heard = hear(lock.work, capture, sound, progress)
        spans = group_spans(capture.frames, config.group.length, config.group.overlap)
        job = Job(config, chosen, progress, Store(lock.work), spans)
        rig, layout = prepare(job, capture, lock)
        writer = open_reel(job, capture, rig, layout, heard, lock)
        reconstruct_groups(job, capture, rig, layout, writer, present)
        return Result(lock.reel, lock.work, job.seconds, chosen.type)


def reconstruct_groups(
    job: Job, capture: Capture, rig: Rig, layout: Layout, writer: ReelWriter, present: Present
) -> None:
    """One group after the other, from the first that is not finished; the next one's frames are decoded ahead."""
    finished = job.store.finished_groups()
    before = Handover(rig, StaticPoints.none(job.config.keyframe.sh_degree), Gaussians.empty())
    publisher = Publisher(writer, job.store, job.device)
    for span in job.spans[:finished]:
        before = restore_group(job, span, before, publisher)
    if finished:
        present(writer, finished - 1)
    todo = job.spans[finished:]
    with FramePrefetcher(capture, rig.names, [(span.first, span.count) for span in todo]) as stretches:
        for span, frames in zip(todo, stretches, strict=True):
            before = reconstruct_group(job, span, frames, before, layout, writer, present)
    present(writer, None)
    writer.finish()


def reconstruct_group(
    job: Job,
    span: GroupSpan,
    frames: np.ndarray,
    before: Handover,
    layout: Layout,
    writer: ReelWriter,
    present: Present,
) -> Handover:
    """The way of a group: a keyframe, what of it rests and what moves, where that goes, and how exactly; then it is published.

    frames: [T, C, H, W, 3] uint8, given up.
    """
    data, rig = look_at_group(job, span, frames, before.rig, layout)
    first = keyframe(job, data, before.dynamic, before.static)
    data, rig = replace(data, gains=first.gains), replace(rig, gains=first.gains)
    layers = layering(job, data, first.points, before.static)
    static = publish_layer(job, data, layers, before.static, writer)
    start = tracking(job, data, layers, static, before.velocity)
    if start.left is not None:
        static = static.without(start.left)
    found = motion(job, data, start, static)
    if job.config.group.time_offsets:
        job.store.group(span.index).save_time_offsets(found.time_offsets.values)
        rig = rig.timed(found.time_offsets.values)
        tell_offsets(rig, found.time_offsets, job.progress)
    group = Group(span.index, span.first, found.dynamic, found.dx, found.dq, found.alive, found.shade, data.light)
    with job.timed("encode"):
        job.say(span, "writing it for players", 1, job.plan.moved(span.index))
        publish_group(job, group, static, writer)
        present(writer, span.index)
        job.progress.update(1)
    return hand_over(span, rig, static, group)


def restore_group(job: Job, span: GroupSpan, before: Handover, publisher: Publisher) -> Handover:
    """What a finished group handed over, from the checkpoints and what it found; the reel gets what it lacks."""
    if span.index < publisher.writer.manifest.end_group:
        publisher.skip(span.index)
    else:
        with job.timed("encode"):
            publisher.publish(span.index)
    store = job.store.group(span.index)
    layer, static = store.layer(), before.static
    if layer is not None:
        static = static.with_layer(layer.decoded)
    rig = restored_rig(before.rig, store, span.own)
    return hand_over(span, rig, static, store.group().group)


def hand_over(span: GroupSpan, rig: Rig, static: StaticPoints, group: Group) -> Handover:
    """At the next keyframe: the dynamic points, deformed there (paper section 4)."""
    return Handover(rig, static.with_alive(group.alive), group.at(span.own), VelocityPrior.of(group, span.own))
