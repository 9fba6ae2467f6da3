"""Steps before the first group: check the cameras, place the initial points, measure the scene, write the reel's header."""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import ReconstructionError
from splatreel.capture.base import Capture
from splatreel.capture.mask_shares import describe_motion, describe_shares, describe_sizes, mask_shares
from splatreel.codec.writer import ReelWriter
from splatreel.method.cameras.rig import Rig, check_first_poses
from splatreel.method.images.people import find_people, how_to_install
from splatreel.method.init.layout import Layout, limits
from splatreel.method.init.visual_hull import is_sparse
from splatreel.method.prediction.quality import Coverage, cover, judge_poses
from splatreel.method.train.single_frame import Subject, lay_out
from splatreel.run.job import Job
from splatreel.run.output.group_writer import header_of, open_writer
from splatreel.run.output.sound_output import Soundtrack, save_soundtrack
from splatreel.run.requirements import check_images
from splatreel.run.run_folder import RunLock
from splatreel.run.steps import POSES
from splatreel.run.store import GroupStore


def prepare(job: Job, capture: Capture, middle: int, lock: RunLock) -> tuple[Rig, Layout]:
    """Check the training cameras, and save the initial points and the measures of the scene. Return both, the cameras and the measures.

    Poses are checked at the first frame and at `middle`, in the middle of the first group. The lock learns that
    the folder belongs to the run.
    """
    store, rig = job.store, Rig.of(capture.training_cameras)
    if (layout := store.layout()) is not None:
        poses = POSES.load(store.group(0))
        return (rig if poses is None else rig.with_poses(poses)), layout
    with job.timed("points"):
        job.progress.stage("reading the first frame, checking the cameras", 1, (0.0, 0.0))
        frames = np.concatenate([capture.scene.read(frame, 1, rig.names) for frame in (0, middle)])
        rig, frames = check_cameras(job, capture, rig, frames, store.group(0))
        job.progress.update(1)
        coverage = report_coverage(job, capture, rig, frames, middle) if job.config.check_coverage else None
        job.show("points", 1)
        known = capture.points, capture.point_colors, capture.near
        images, subject = first_images(capture, rig, frames[0])
        if subject is not None and is_sparse(rig.cameras) and find_people() is None:
            job.progress.note(f"masks alone tell the shape. Networks of people find skeletons too: {how_to_install()}")
        seeds, layout = lay_out(rig.cameras, images, job.config, *known, subject)
        check_region_holds(layout, rig, seeds.points)
        job.progress.update(1, points=len(seeds.points))
    lock.save_record()
    if coverage is not None:
        store.save_coverage(coverage)
    store.save_layout(layout, seeds.points, seeds.colors)
    return rig, layout


def first_images(capture: Capture, rig: Rig, images: np.ndarray) -> tuple[np.ndarray, Subject | None]:
    """Return the images that initial points are found in, and the subject that masks show.

    Args:
        capture: The capture.
        rig: The cameras that are trained on.
        images: Their images [C, H, W, 3] uint8 of the first frame, which show the whole scene.
    """
    alpha = capture.alpha(0, 1, rig.names)
    if alpha is None:
        return images, None
    return capture.read(0, 1, rig.names)[0], Subject(alpha[0], capture.backgrounds)


def check_region_holds(layout: Layout, rig: Rig, points: np.ndarray) -> None:
    """Raise `ReconstructionError` if no initial point [P, 3] is within the region."""
    volume = layout.volume(rig.cameras)
    if volume is not None and not volume.contains(points).any():
        low, high = (", ".join(f"{value:.3g}" for value in corner) for corner in layout.bounds)
        raise ReconstructionError(
            f"region={layout.region}: nothing of the scene is there in the first frame. Most of the scene is between {low} and {high}."
        )


def save_header(job: Job, capture: Capture, rig: Rig, layout: Layout, sound: Soundtrack | None) -> None:
    """Save what the reel says before its first group: the header, the limits of views, the sound."""
    store = job.store
    coverage = store.coverage()
    farthest = None if coverage is None else coverage.angle
    holds = limits(rig.cameras, store.initial_points()[0], layout, farthest)
    store.save_header(header_of(rig.cameras, capture.fps, job.config, layout, capture.reel_source()), holds)
    save_soundtrack(store.work, sound)


def open_reel_writer(job: Job, lock: RunLock) -> ReelWriter:
    """Return the writer of a run's reel, which continues an interrupted one."""
    return open_writer(job.store, lock.reel, job.config.encode, resume=True)


def check_cameras(
    job: Job, capture: Capture, rig: Rig, frames: np.ndarray, store: GroupStore
) -> tuple[Rig, np.ndarray]:
    """Correct the poses of the cameras, and leave out cameras that show something else. Return those that are left, and their images.

    Args:
        job: The run.
        capture: The capture.
        rig: The training cameras.
        frames: Images [T, C, H, W, 3] uint8 of some moments. The first and the middle one are compared.
        store: Checkpoints that keep the poses.
    """
    compared = frames[[0, len(frames) // 2]]
    check_images(capture, rig.names, compared)
    for sentence in [*capture.notes, *capture.doubts]:
        job.progress.note(sentence)
    if not job.config.check_poses:
        return rig, frames
    poses = check_first_poses(rig, compared, str(capture.origin), job.progress)
    POSES.save(store, poses)
    assert poses.kept is not None
    return rig.with_poses(poses), frames[:, poses.kept]


def report_coverage(job: Job, capture: Capture, rig: Rig, frames: np.ndarray, middle: int = 0) -> Coverage:
    """Measure and report how well the cameras cover the scene, before anything is trained.

    The cameras' images [T, C, H, W, 3] uint8 are of the first frame and, if there are more, `middle`. So are the masks.
    """
    known = {"points": capture.points, "point_colors": capture.point_colors, "near": capture.near}
    masks = [alpha for frame in {0, middle} if (alpha := capture.alpha(frame, 1, rig.names)) is not None]
    alpha = np.concatenate(masks) if masks else None
    found = cover(rig.cameras, frames[0], **known, progress=job.progress, alpha=alpha)
    about_masks: list[str] = []
    if alpha is not None:
        about_masks += [*describe_shares(rig.names, mask_shares(alpha[:1])), *describe_sizes(rig.cameras, alpha)]
        about_masks += describe_motion(rig.names, frames, alpha) if len(frames) == len(alpha) == 2 else []
    verdict = judge_poses(found)
    advice = " Make masks, then check with `splatreel capture check --masks`." if verdict.needs_masks else ""
    doubts = verdict.faults or [verdict.unconfirmed + advice] * bool(verdict.unconfirmed)
    for sentence in [*about_masks, *found.sentences(), *doubts]:
        job.progress.note(sentence)
    return found
