"""Reconstruction of groups, one after the other: each starts from the state that the group before it passed on."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from splatreel.base.errors import ReconstructionError
from splatreel.capture.base import Capture
from splatreel.capture.reading import FramePrefetcher
from splatreel.codec.preview import remove_previews, write_preview
from splatreel.method.algorithm import NextGroup, Start, hand_over, reconstruct_group
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.init.layout import Layout
from splatreel.method.init.visual_hull import is_sparse
from splatreel.method.train.group_trainer import GroupResult
from splatreel.run.job import Job, StepRun
from splatreel.run.output.group_output import Output
from splatreel.run.steps import TIME_OFFSETS, restored_rig
from splatreel.run.store import Store
from splatreel.scene.gaussians import Gaussians
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

    The first group starts from the state `before`. A chapter has plates, images [C, H, W, 3] uint8 of the shared scene.
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
    """Reconstruct one group, with checkpoints, and write it. Return the state for the next group.

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


FIRST_AFTER, EVERY = 4.0, 8.0
"""Seconds of training before the first preview, and from one preview to the next. Short trainings have none."""
MAX_SHARE = 0.05
"""Maximum share of the time that previews take."""


class KeyframePreview:
    """Writer of a preview every few seconds of training. Previews do not change the training."""

    def __init__(self, store: Store, clock: Callable[[], float] = time.monotonic) -> None:
        """Prepare the writer. The time counts from the first call of `show`.

        Args:
            store: Checkpoints of the run in OUT/work.
            clock: Time in seconds.
        """
        self._store = store
        self._clock = clock
        self._due: float | None = None
        self.written: Path | None = None
        """Folder of the last preview; None if none was due yet."""

    def show(self, gaussians: Callable[[], Gaussians]) -> None:
        """Write a preview if it is time for one. `gaussians` returns the points as they are now."""
        if self._due is None:
            self._due = self._clock() + FIRST_AFTER
        elif self._clock() >= self._due:
            self._write(gaussians())

    def finish(self, points: Gaussians) -> None:
        """Write the trained points, if the training took long enough for a preview."""
        if self.written is not None:
            self._write(points)

    def _write(self, points: Gaussians) -> None:
        begin = self._clock()
        try:
            header, limits = self._store.header()
        except ReconstructionError:  # a training without a reel
            self._due = float("inf")
            return
        self.written = write_preview(self._store.work.parent, header, limits, points)
        now = self._clock()
        self._due = now + max(EVERY, (now - begin) / MAX_SHARE)
