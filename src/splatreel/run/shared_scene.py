"""The scene that all chapters of a long video share: points that are always there, trained once and then frozen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatreel.capture.base import Capture
from splatreel.codec.encoder import ReelEncoder
from splatreel.method.cameras.exposure import measure_exposure, remove_exposure
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.rig import Rig
from splatreel.method.encode.compression import Coding, compress_layer
from splatreel.method.images.temporal_mean import CleanPlates, clean_plates
from splatreel.method.init.initial_points import initial_points, near_plane
from splatreel.method.init.layout import Layout, border_color, measure
from splatreel.method.layering.lift import shares
from splatreel.method.train.keyframe_trainer import KeyframeResult
from splatreel.method.train.stages import train_first_keyframe
from splatreel.run.job import Job, StepRun
from splatreel.run.output.sound_output import Soundtrack
from splatreel.run.preparation import check_cameras, check_region_holds, report_coverage, save_header
from splatreel.run.run_folder import RunLock
from splatreel.run.steps import restored_rig
from splatreel.run.store import GroupStore, StoredLayer
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import GroupSpan

SAMPLES = 24
"""Frames of the video that the clean plates are made from. A passer-by hides a place in few of them."""
MOMENTS = 3
"""Sampled frames whose own points count in the measures of the scene. Moving people are not in the plates."""
UNKNOWN = 0.5
"""Share of a point's visible area that may lie where the plates are unknown."""
PLATE = GroupSpan(0, 0, 1, 1)
"""The plates of all cameras, taken as a group of one frame."""


def reconstruct_shared_scene(job: Job, capture: Capture, sound: Soundtrack | None, lock: RunLock) -> None:
    """Make clean plates, train them as the first keyframe of a video, and encode the points as a layer."""
    store = job.store.scene
    if store.has_layer():
        return
    rig, layout, plates = _prepare_scene(job, capture, lock)
    save_header(job, capture, rig, layout, sound)
    config = job.config
    data = GroupInput(PLATE, plates.images[None], rig, None, layout, config.seed, config.antialias, gpu=job.gpu)
    found = StepRun(job, store)("scene keyframe", _train, data, job, plates)
    _save_layer(job, data, found.points, plates)


def shared_rig(job: Job, capture: Capture) -> Rig:
    """Return the cameras as the shared scene found them. Each chapter begins with these."""
    return restored_rig(Rig.of(capture.training_cameras), job.store.scene, 1)


def load_plates(store: GroupStore) -> CleanPlates | None:
    """Return the saved clean plates; None where there are none."""
    arrays = store.load("plates")
    return None if arrays is None else CleanPlates(arrays["images"], arrays["unknown"])


def _prepare_scene(job: Job, capture: Capture, lock: RunLock) -> tuple[Rig, Layout, CleanPlates]:
    """Return cameras, measures of the scene and plates, from frames sampled through the video; save the initial points."""
    store = job.store
    if (layout := store.layout()) is not None and (plates := load_plates(store.scene)) is not None:
        return shared_rig(job, capture), layout, plates
    with job.timed("points"):
        rig = Rig.of(capture.training_cameras)
        frames = _sample_frames(job, capture, rig)
        rig, frames = check_cameras(job, capture, rig, frames, store.scene)
        coverage = report_coverage(job, capture, rig, frames[:1]) if job.config.check_coverage else None
        job.show("points", MOMENTS + 1)
        if job.config.even_exposure:
            remove_exposure(frames, measure_exposure(rig, frames))
        plates = clean_plates(frames)
        layout, points, colors = _lay_out(job, rig, plates, frames)
    lock.save_record()
    if coverage is not None:
        store.save_coverage(coverage)
    store.scene.save("plates", plates._asdict())
    store.save_layout(layout, points, colors)
    return rig, layout, plates


def _sample_frames(job: Job, capture: Capture, rig: Rig) -> np.ndarray:
    """Return images [T, C, H, W, 3] uint8 of frames spread over the video."""
    at = np.linspace(0, capture.frames - 1, min(SAMPLES, capture.frames)).round().astype(int)
    job.progress.stage("reading frames of the whole video", len(at), (0.0, 0.0))
    frames = np.empty((len(at), len(rig.names), capture.height, capture.width, 3), np.uint8)
    for place, frame in enumerate(at):
        frames[place] = capture.read(int(frame), 1, rig.names)[0]
        job.progress.update(place + 1)
    return frames


def _lay_out(job: Job, rig: Rig, plates: CleanPlates, frames: np.ndarray) -> tuple[Layout, np.ndarray, np.ndarray]:
    """Return the measures of the scene with everything that moves in it, and the plates' initial points [P, 3] and colors [P, 3]."""
    seeds = initial_points(rig.cameras, plates.images, seed=job.config.seed)
    job.progress.update(1, points=len(seeds.points))
    seen = [seeds.points]
    for number, place in enumerate(np.linspace(0, len(frames) - 1, MOMENTS).round().astype(int)):
        seen.append(initial_points(rig.cameras, frames[place], seed=job.config.seed).points)
        job.progress.update(number + 2)
    everything = np.concatenate(seen)
    layout = replace(measure(rig.cameras, everything, near_plane(rig.cameras, everything)), region=job.config.region)
    check_region_holds(layout, rig, everything)
    if job.config.background:
        layout = replace(layout, background=border_color(plates.images))
    return layout, seeds.points, seeds.colors


def _train(data: GroupInput, job: Job, plates: CleanPlates) -> KeyframeResult:
    """Train the plates as a keyframe. Unknown pixels teach nothing."""
    seeds = job.store.initial_points()
    found = train_first_keyframe(data, *seeds, job.config, job.progress, plates.unknown)
    found.points.check_finite("The scene that all chapters share")
    return found


def _save_layer(job: Job, data: GroupInput, points: Gaussians, plates: CleanPlates) -> None:
    """Encode the points that the plates show, and save them as trained and as decoded."""
    store, scene = job.store, job.store.scene
    hidden = shares(points, data.cameras, plates.unknown, data.near)
    # The share is NaN for a point that no camera sees; the comparison is then false.
    known = points[~(hidden > UNKNOWN)]
    if len(known) == 0:
        return scene.save_layer(StoredLayer(known, known))
    with job.timed("encode"):
        job.progress.stage("encoding the scene that all chapters share", 1, (1.0, 1.0))
        none, coding = known[:0], Coding(ReelEncoder(job.config.encode, data.cameras), store.header()[0], store.trial())
        layer = compress_layer(data, known, none, none, coding)
        scene.save_encoded_layer(layer.files)
        scene.save_layer(StoredLayer(layer.trained, layer.decoded, layer.importance, layer.steps))
        job.progress.update(1, points=len(known))
