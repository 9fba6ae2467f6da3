"""The stages of a group. Each takes what all look at (`GroupInput`), points and its own settings, and gives what it found.

What a stage found is in the group's folder as soon as it is found. A stage that is called again loads it.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import torch

from splatreel.codec.predictive.precision import STEPS
from splatreel.recon.cameras.exposure import at_next_keyframe, measure_exposure, take_out, tell_exposure
from splatreel.recon.cameras.group_input import GroupInput
from splatreel.recon.cameras.rig import Rig, check_poses_again
from splatreel.recon.encode.group_output import Output
from splatreel.recon.encode.importance import group_importance, weigh
from splatreel.recon.encode.step_choice import encode_group_by_slope, encode_layer_by_slope
from splatreel.recon.init.layout import Layout
from splatreel.recon.layering.labels import Layers, find_layers
from splatreel.recon.layering.tracking import GroupStart, track
from splatreel.recon.layering.velocity_prior import VelocityPrior
from splatreel.recon.run.device import check_room
from splatreel.recon.run.job import Job
from splatreel.recon.run.store import StoredGroup, StoredLayer, once
from splatreel.recon.train.chapter_keyframe import ChapterStart, start_chapter
from splatreel.recon.train.group import GroupResult
from splatreel.recon.train.keyframe import KeyframeResult
from splatreel.recon.train.stages import train_first_keyframe, train_group, train_keyframe
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.spans import GroupSpan
from splatreel.scene.static_points import StaticPoints


def look_at_group(
    job: Job, span: GroupSpan, frames: np.ndarray, rig: Rig, layout: Layout, reference: np.ndarray | None = None
) -> tuple[GroupInput, Rig]:
    """What all other stages look at, and the rig as the next group finds it, as far as that is known yet.

    frames: [T, C, H, W, 3] uint8, which are given up: exposures are taken out of them. reference: as in `measure_exposure`.
    """
    config, store, light = job.config, job.store.group(span.index), None
    if job.device.type == "cuda":
        check_room(frames.nbytes, torch.cuda.mem_get_info(job.device)[0], frames.shape[3])
    with job.timed("exposure"):
        if config.even_exposure:
            exposure = once(store.exposure, partial(measure_exposure, rig, frames, reference), store.save_exposure)
            tell_exposure(rig, exposure, job.progress)
            take_out(frames, exposure)
            rig, light = at_next_keyframe(rig, exposure, span.own), exposure.light_factors
    with job.timed("poses"):
        if config.check_poses:
            moments = frames[[0, len(frames) // 2]]
            rig = rig.standing(
                once(store.poses, partial(check_poses_again, rig, moments, job.progress), store.save_poses)
            )
    data = GroupInput(
        span=span,
        images=frames,
        cameras=rig.cameras,
        gains=rig.gains,
        time_offsets=rig.time_offsets,
        light=light,
        layout=layout,
        device=job.device,
        seed=config.seed,
        antialias=config.antialias,
    )
    return data, rig


def keyframe(job: Job, data: GroupInput, dynamic: Gaussians, static: StaticPoints) -> KeyframeResult:
    """The Gaussians of the keyframe. First group: all points; later: the dynamic ones, before the frozen static ones."""
    span, config, store = data.span, job.config.keyframe, job.store.group(data.span.index)

    def train() -> KeyframeResult:
        share = job.plan.keyframe(span.index)
        with job.timed("keyframe"):
            if span.index == 0:
                job.say(span, "building the scene at its first frame", config.first_iterations, share)
                found = train_first_keyframe(data, *job.store.initial_points(), job.config, job.progress)
            else:
                job.say(span, "refining what moves at its first frame", config.refine_iterations, share)
                found = train_keyframe(data, dynamic, static, job.config, job.progress)
        found.points.check_finite(f"Keyframe {span.index}")
        return found

    if span.index and not len(dynamic):
        return KeyframeResult(dynamic, data.gains)
    return once(store.keyframe, train, store.save_keyframe)


def chapter_start(job: Job, data: GroupInput, static: StaticPoints) -> ChapterStart:
    """What the first frame of a chapter has beside the static points that all chapters share, and which of these it has not."""
    span, store = data.span, job.store.group(data.span.index)

    def train() -> ChapterStart:
        with job.timed("keyframe"):
            iterations = job.config.keyframe.first_iterations
            job.say(span, "building what its first frame adds", iterations, job.plan.keyframe(span.index))
            found = start_chapter(data, static, job.config, job.progress)
            job.progress.update(iterations, points=len(found.points))
        found.points.check_finite(f"Chapter of group {span.index}")
        return found

    return once(store.chapter_start, train, store.save_chapter_start)


def layering(job: Job, data: GroupInput, dynamic: Gaussians, static: StaticPoints) -> Layers:
    """Which of all points rest in this group, and which move (paper 4.1)."""
    span, store = data.span, job.store.group(data.span.index)

    def find() -> Layers:
        with job.timed("layering"):
            job.say(span, "telling what moves from what rests", 1, job.plan.layering(span.index))
            found = find_layers(data, dynamic, static, job.config.layering)
            resting = len(found.settled) + int(found.alive.sum())
            lit = {"lit": len(found.relit)} if len(found.relit) else {}
            job.progress.update(1, moving=len(found.dynamic), resting=resting, **lit)
        return found

    return once(store.layers, find, store.save_layers)


def publish_layer(job: Job, data: GroupInput, layers: Layers, static: StaticPoints, output: Output) -> StaticPoints:
    """Store the new static points as a layer, and go on with what a reader of the reel will see of them (closed loop)."""
    static = static.with_alive(layers.alive)
    if len(layers.settled) == 0:
        return static
    span = data.span
    with job.timed("encode"):
        job.say(span, "writing what rests", 1, job.plan.layered(span.index))
        seen = Gaussians.concatenate([layers.settled, layers.dynamic, layers.relit.points, static.living])
        count = len(layers.settled)
        importance = weigh([seen], data.cameras, data.near, job.device, data.antialias)[:count]
        moving = len(layers.dynamic) + len(layers.relit)
        encoded, steps = encode_layer_by_slope(
            output.encoder, data, layers.settled, seen[count:], moving, importance, job.trial
        )
        decoded, order = output.add_layer(span.index, span.first, layers.settled, encoded), encoded[1]
        job.progress.update(1, points=len(decoded))
    job.store.group(span.index).save_layer(StoredLayer(layers.settled[order], decoded, importance[order], steps))
    return static.with_layer(decoded)


def tracking(
    job: Job, data: GroupInput, layers: Layers, static: StaticPoints, velocity: VelocityPrior | None
) -> GroupStart:
    """Tracks of the dynamic points, to start their deformation from, and new points for what appears."""
    span, store = data.span, job.store.group(data.span.index)
    dynamic, relit = layers.dynamic, layers.relit

    def find() -> GroupStart:
        with job.timed("tracking"):
            job.say(span, "following what moves", span.count, job.plan.tracking(span.index))
            velocities = velocity and velocity.at(dynamic.means, data.unit)
            found = track(data, dynamic, relit, static, velocities, job.config.layering, job.progress)
            appeared = len(found.dynamic) - len(dynamic) - len(relit)
            job.progress.update(span.count, moving=len(found.dynamic), appeared=appeared)
        return found

    if not job.config.group.tracks or span.count < 2:
        return GroupStart(Gaussians.concatenate([dynamic, relit.points]))
    return once(store.start, find, store.save_start)


def motion(job: Job, data: GroupInput, start: GroupStart, static: StaticPoints) -> GroupResult:
    """How the dynamic points move over the group (paper 4.2)."""
    span = data.span
    with job.timed("group"):
        iterations = job.config.group.iterations_per_frame * span.count
        job.say(span, "learning how it moves", iterations, job.plan.motion(span.index))
        found = train_group(data, start, static, job.config, job.progress)
        job.progress.update(iterations, moving=len(found.dynamic))
    found.dynamic.check_finite(f"Group {span.index}")
    return found


def publish_group(job: Job, data: GroupInput | None, group: Group, static: StaticPoints, output: Output) -> None:
    """Keep the finished group, and then write it for players: what is in the reel is never trained again.

    data: its pictures, which say how finely it must be encoded; None: there are none.
    """
    encoder = output.encoder
    importance = group_importance(output.header, encoder.config, static.points, group, job.device)[0]
    if data is None:
        files, steps = encoder.group(group, importance), STEPS
    else:
        files, steps = encode_group_by_slope(encoder, data, group, static, importance, job.trial)
    job.store.group(group.index).save_group(StoredGroup(group, importance, steps))
    output.add_group(group, files)
