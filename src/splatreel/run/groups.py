"""Reconstruction of groups, one after the other: each starts from the state that the group before it passed on."""

from __future__ import annotations

import numpy as np

from splatreel.capture.base import Capture
from splatreel.capture.prefetch import FramePrefetcher
from splatreel.codec.preview import remove_previews
from splatreel.method.algorithm import NextGroup, Start, hand_over, reconstruct_group
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.init.layout import Layout
from splatreel.method.init.visual_hull import is_sparse
from splatreel.method.train.group_trainer import GroupResult
from splatreel.run.job import Job
from splatreel.run.output.group_output import Output
from splatreel.run.output.keyframe_preview import KeyframePreview
from splatreel.run.step_checkpoints import TIME_OFFSETS, restored_rig
from splatreel.run.step_run import StepRun
from splatreel.scene.group import GroupSpan


def reconstruct_groups(
    job: Job,
    spans: list[GroupSpan],
    capture: Capture,
    layout: Layout,
    before: Start,
    output: Output,
    plates: np.ndarray | None = None,
) -> None:
    """Reconstruct groups in order, from the first that is not finished. A thread decodes the frames of the next group ahead.

    Args:
        job: The run, or the chapter.
        spans: Its groups.
        capture: The capture that the frames are read from.
        layout: Measures of the scene.
        before: State that the first of the groups starts from.
        output: Destination of finished layers and groups.
        plates: Images [C, H, W, 3] uint8 of the shared scene, for a chapter.
    """
    finished = min(job.store.finished_groups(spans[0].index), len(spans))
    for place, span in enumerate(spans[:finished]):
        before = restore_group(job, span, before)
        output.restore(span.index, last=place + 1 == finished)
    todo = spans[finished:]
    with FramePrefetcher(capture, before.rig.names, [(span.first, span.count) for span in todo]) as stretches:
        for span, frames in zip(todo, stretches, strict=True):
            missing = capture.missing(span.first, span.count, before.rig.names)
            few = is_sparse(before.rig.cameras)
            alpha = capture.alpha(span.first, span.count, before.rig.names) if few else None
            before = run_group(job, span, frames, before, layout, output, plates, missing, alpha)


def run_group(
    job: Job,
    span: GroupSpan,
    frames: np.ndarray,
    before: Start,
    layout: Layout,
    output: Output,
    plates: np.ndarray | None = None,
    missing: np.ndarray | None = None,
    alpha: np.ndarray | None = None,
) -> NextGroup:
    """Reconstruct one group, with checkpoints, and write it.

    Args:
        job: The run.
        span: Frames of the group.
        frames: Images [T, C, H, W, 3] uint8, which this function changes.
        before: State that the group before it passed on.
        layout: Measures of the scene.
        output: Destination of the finished layer and group.
        plates: Images [C, H, W, 3] uint8 of the shared scene, for a chapter.
        missing: [T, C] bool, images that the cameras lack; None if all exist.
        alpha: [T, C, H, W] uint8, opacity of a subject before few cameras; None for all others.

    Returns:
        State for the next group.
    """
    config, store = job.config, job.store.group(span.index)
    if missing is not None:  # an image that stands in for a frame without any is better than none
        missing = missing & ~missing.all(1, keepdims=True)
        missing = missing if missing.any() else None
    data = GroupInput(
        span,
        frames,
        before.rig,
        None,
        layout,
        config.seed,
        config.antialias,
        missing=missing,
        plates=plates,
        gpu=job.gpu,
        alpha=alpha,
    )

    def save_offsets(found: GroupResult) -> None:
        if found.time_offsets is not None:
            TIME_OFFSETS.save(store, found.time_offsets.values)

    run = StepRun(job, store, span, {"layer": output.add_layer, "motion": save_offsets, "encode": output.add_group})
    after = reconstruct_group(data, before, config, output.coding, run, KeyframePreview(job.store))
    remove_previews(job.store.work.parent)  # players now show the group
    return after


def restore_group(job: Job, span: GroupSpan, before: Start) -> NextGroup:
    """Return the state that a finished group passed on, from its checkpoints."""
    store = job.store.group(span.index)
    layer, static = store.layer(), before.static
    if layer is not None:
        static = static.with_layer(layer.decoded)
    return hand_over(restored_rig(before.rig, store, span.own), static, store.group().group, span.own)
