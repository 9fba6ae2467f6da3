"""Before the first group: what the first frame tells of cameras and scene, and the reel's header."""

from __future__ import annotations

import numpy as np

from splatreel.capture.base import Capture
from splatreel.codec.writer import ReelWriter
from splatreel.recon.cameras.rig import Rig, check_first_poses
from splatreel.recon.coverage.coverage import Coverage, cover
from splatreel.recon.encode.header import header_of, open_writer
from splatreel.recon.encode.soundtrack import Soundtrack, save_soundtrack
from splatreel.recon.init.layout import Layout
from splatreel.recon.init.limits import limits
from splatreel.recon.run.job import Job
from splatreel.recon.run.requirements import check_pictures
from splatreel.recon.run.run_lock import RunLock
from splatreel.recon.run.store import GroupStore
from splatreel.recon.train.single_frame import lay_out


def prepare(job: Job, capture: Capture, lock: RunLock) -> tuple[Rig, Layout]:
    """The cameras that are trained on, and the measures of the scene; its initial points are in the store from then on."""
    store, rig = job.store, Rig.of(capture.training_cameras)
    if (layout := store.layout()) is not None:
        poses = store.group(0).poses()
        return (rig if poses is None else rig.standing(poses)), layout
    with job.timed("points"):
        job.progress.stage("reading the first frame, checking the cameras", 1, (0.0, 0.0))
        moments = [0, job.spans[0].count // 2]
        frames = np.concatenate([capture.read(frame, 1, rig.names) for frame in moments])
        rig, frames = check_cameras(job, capture, rig, frames, store.group(0))
        job.progress.update(1)
        coverage = tell_coverage(job, capture, rig, frames[0]) if job.config.check_coverage else None
        job.progress.stage("finding where the scene's surfaces are", 1, job.plan.points())
        known = capture.points, capture.point_colors, capture.near
        seeds, layout = lay_out(rig.cameras, frames[0], job.config, *known)
        job.progress.update(1, points=len(seeds.points))
    lock.keep()
    if coverage is not None:
        store.save_coverage(coverage)
    store.save_layout(layout, seeds.points, seeds.colors)
    return rig, layout


def save_header(job: Job, capture: Capture, rig: Rig, layout: Layout, sound: Soundtrack | None) -> None:
    """What is known of the reel beforehand: header, limits of views, sound."""
    store = job.store
    coverage = store.coverage()
    farthest = None if coverage is None else coverage.angle
    holds = limits(rig.cameras, store.initial_points()[0], layout, farthest)
    store.save_header(header_of(rig.cameras, capture.fps, job.config, layout), holds)
    save_soundtrack(store.work, sound)


def open_reel(job: Job, lock: RunLock) -> ReelWriter:
    """The reel of a run, which goes on where it was cut off."""
    return open_writer(job.store, lock.reel, job.config.encode, resume=True)


def check_cameras(
    job: Job, capture: Capture, rig: Rig, frames: np.ndarray, store: GroupStore
) -> tuple[Rig, np.ndarray]:
    """Cameras as they stand, without those that show something else, and their pictures.

    frames: [T, C, H, W, 3] uint8, some moments; the first and the middle one are looked at. store: keeps what was found.
    """
    frames_seen = frames[[0, len(frames) // 2]]
    check_pictures(capture, rig.names, frames_seen)
    for doubt in capture.doubts:
        job.progress.note(doubt)
    if not job.config.check_poses:
        return rig, frames
    poses = check_first_poses(rig, frames_seen, str(capture.origin), job.progress)
    store.save_poses(poses)
    assert poses.kept is not None
    return rig.standing(poses), frames[:, poses.kept]


def tell_coverage(job: Job, capture: Capture, rig: Rig, images: np.ndarray) -> Coverage:
    """What to expect of new views, told before it is trained. images: [C, H, W, 3] uint8, of the first frame."""
    known = {"points": capture.points, "point_colors": capture.point_colors, "near": capture.near}
    found = cover(rig.cameras, images, **known, device=job.device, progress=job.progress)
    for sentence in found.sentences():
        job.progress.note(sentence)
    return found
