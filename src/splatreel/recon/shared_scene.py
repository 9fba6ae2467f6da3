"""The scene that all chapters of a long video share: what is always there, reconstructed once and then frozen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatreel.capture.base import Capture
from splatreel.codec.encoder import ReelEncoder
from splatreel.codec.group_file import decode_layer
from splatreel.motion.clean_plates import CleanPlates, clean_plates
from splatreel.motion.lift import shares
from splatreel.recon.cameras.exposure import measure_exposure, take_out
from splatreel.recon.cameras.group_input import GroupInput
from splatreel.recon.cameras.rig import Rig
from splatreel.recon.encode.importance import weigh
from splatreel.recon.encode.soundtrack import Soundtrack
from splatreel.recon.encode.step_choice import encode_layer_by_slope
from splatreel.recon.init.initial_points import initial_points, near_plane
from splatreel.recon.init.layout import Layout, border_color, measure
from splatreel.recon.preparation import check_cameras, save_header, tell_coverage
from splatreel.recon.run.job import Job
from splatreel.recon.run.run_lock import RunLock
from splatreel.recon.run.store import StoredLayer, once, restored_rig
from splatreel.recon.train.keyframe import KeyframeResult
from splatreel.recon.train.stages import train_first_keyframe
from splatreel.scene.gaussians import Gaussians

SAMPLES = 24
"""Frames of the video that its plates are made from: somebody who crosses the picture is in the way in few of them."""
MOMENTS = 3
"""Of these, those whose own points the scene's measures are taken from as well: who walks about is not in the plates."""
UNKNOWN = 0.5
"""Share of what a point shows that may lie where the plates mean nothing."""


def reconstruct_shared_scene(job: Job, capture: Capture, sound: Soundtrack | None, lock: RunLock) -> None:
    """Make clean plates, reconstruct them as the first keyframe of a video, and encode the points as a layer; all of it is kept."""
    store = job.store.scene
    if store.has_layer():
        return
    rig, layout, plates = _look_at_video(job, capture, lock)
    save_header(job, capture, rig, layout, sound)
    data = _input_of(job, rig, layout, plates)

    def train() -> KeyframeResult:
        with job.timed("keyframe"):
            iterations, share = job.config.keyframe.first_iterations, job.plan.keyframe(0)
            job.progress.stage("building what all chapters share", iterations, share)
            seeds = job.store.initial_points()
            return train_first_keyframe(data, *seeds, job.config, job.progress, plates.unknown)

    found = once(store.keyframe, train, store.save_keyframe)
    found.points.check_finite("The scene that all chapters share")
    _save_layer(job, data, found.points, plates)


def shared_rig(job: Job, capture: Capture) -> Rig:
    """The cameras as the scene found them, which each chapter begins with."""
    return restored_rig(Rig.of(capture.training_cameras), job.store.scene, 1)


def _look_at_video(job: Job, capture: Capture, lock: RunLock) -> tuple[Rig, Layout, CleanPlates]:
    """Cameras, measures, initial points and plates, from frames sampled through the video."""
    store = job.store
    if (layout := store.layout()) is not None and (plates := store.scene.plates()) is not None:
        return shared_rig(job, capture), layout, plates
    with job.timed("points"):
        rig = Rig.of(capture.training_cameras)
        at = np.linspace(0, capture.frames - 1, min(SAMPLES, capture.frames)).round().astype(int)
        job.progress.stage("reading frames of the whole video", len(at), (0.0, 0.0))
        frames = np.empty((len(at), len(rig.names), capture.height, capture.width, 3), np.uint8)
        for place, frame in enumerate(at):
            frames[place] = capture.read(int(frame), 1, rig.names)[0]
            job.progress.update(place + 1)
        rig, frames = check_cameras(job, capture, rig, frames, store.scene)
        coverage = tell_coverage(job, capture, rig, frames[0]) if job.config.check_coverage else None
        job.progress.stage("finding where the scene's surfaces are", MOMENTS + 1, job.plan.points())
        if job.config.even_exposure:
            take_out(frames, measure_exposure(rig, frames))
        plates = clean_plates(frames)
        layout, points, colors = _lay_out(job, rig, plates, frames)
    lock.keep()
    if coverage is not None:
        store.save_coverage(coverage)
    store.scene.save_plates(plates)
    store.save_layout(layout, points, colors)
    return rig, layout, plates


def _lay_out(job: Job, rig: Rig, plates: CleanPlates, frames: np.ndarray) -> tuple[Layout, np.ndarray, np.ndarray]:
    """Measures of the scene with all that comes and goes in it, and the initial points of the plates, [P, 3] with colors [P, 3]."""
    seeds = initial_points(rig.cameras, plates.images, seed=job.config.seed)
    job.progress.update(1, points=len(seeds.points))
    seen = [seeds.points]
    for number, place in enumerate(np.linspace(0, len(frames) - 1, MOMENTS).round().astype(int)):
        seen.append(initial_points(rig.cameras, frames[place], seed=job.config.seed).points)
        job.progress.update(number + 2)
    everything = np.concatenate(seen)
    layout = measure(rig.cameras, everything, near_plane(rig.cameras, everything))
    if job.config.background:
        layout = replace(layout, background=border_color(plates.images))
    return layout, seeds.points, seeds.colors


def _input_of(job: Job, rig: Rig, layout: Layout, plates: CleanPlates) -> GroupInput:
    return GroupInput(
        span=job.spans[0],
        images=plates.images[None],
        cameras=rig.cameras,
        gains=rig.gains,
        time_offsets=rig.time_offsets,
        light=None,
        layout=layout,
        device=job.device,
        seed=job.config.seed,
        antialias=job.config.antialias,
    )


def _save_layer(job: Job, data: GroupInput, points: Gaussians, plates: CleanPlates) -> None:
    """Keep the points that plates tell of, encoded, and as every reader will see them."""
    store = job.store.scene
    hidden = shares(points, data.cameras, plates.unknown, data.near, data.device)
    known = points[~(hidden > UNKNOWN)]  # of NaN, which no camera sees, all comparisons are false
    if len(known) == 0:
        return store.save_layer(StoredLayer(known, known))
    with job.timed("encode"):
        job.progress.stage("writing what all chapters share", 1, job.plan.layered(0))
        importance = weigh([known], data.cameras, data.near, job.device, data.antialias)
        none = known[:0]
        (encoded, order), steps = encode_layer_by_slope(
            ReelEncoder(job.config.encode), data, known, none, 0, importance, job.trial
        )
        store.save_encoded_layer(encoded)
        decoded = decode_layer(encoded, "The layer that all chapters share")[1]
        store.save_layer(StoredLayer(known[order], decoded, importance[order], steps))
        job.progress.update(1, points=len(known))
