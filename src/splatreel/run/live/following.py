"""Reconstruction of a growing capture to a live reel. Each group is written as soon as it is trained."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Queue

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Progress, Silent
from splatreel.capture.follower import Follower
from splatreel.capture.prefetch import FramePrefetcher
from splatreel.codec.encoder import EncodedLayer
from splatreel.codec.predictive.precision import STEPS
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config
from splatreel.config.records import with_former_defaults
from splatreel.method.algorithm import Handover
from splatreel.method.cameras.rig import Rig
from splatreel.method.encode.compression import CompressedGroup, CompressedLayer
from splatreel.method.encode.importance import group_importance, weigh
from splatreel.method.init.layout import Layout
from splatreel.run.device_choice import largest_buffer, pick_gpu
from splatreel.run.groups import restore_group, run_group
from splatreel.run.job import Job
from splatreel.run.live.lateness import Lateness, WhenLate
from splatreel.run.live.live_soundtrack import LiveSoundtrack
from splatreel.run.live.retention import (
    EPOCH,
    Window,
    first_kept,
    load_rig,
    retirement_group,
    save_epochs,
    starts_epoch,
    static_before,
    trained_points,
)
from splatreel.run.memory import check_memory
from splatreel.run.output.group_output import Output, ReelOutput
from splatreel.run.output.group_writer import GroupWriter, PresentationHook, no_presentation, open_writer
from splatreel.run.pipeline import Result
from splatreel.run.preparation import prepare, save_header
from splatreel.run.requirements import check_capture, check_networks
from splatreel.run.run_lock import RunLock
from splatreel.run.run_record import recorded_settings, run_record
from splatreel.run.store import Store
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group, GroupSpan, group_spans


@dataclass(frozen=True)
class Live:
    """Settings of a live reel.

    Attributes:
        when_late: Reaction to frames that arrive faster than groups are reconstructed.
        keep: Seconds of video that the reel keeps; None keeps all.
    """

    when_late: WhenLate = "wait"
    keep: float | None = None


def reconstruct_following(
    follower: Follower,
    out: Path,
    config: Config,
    live: Live = Live(),
    *,
    sound: str = "auto",
    device: str = "auto",
    progress: Progress | None = None,
    present: PresentationHook = no_presentation,
) -> Result:
    """Reconstruct a capture while it is being written, until it ends. Another call continues.

    Args:
        follower: The growing capture.
        out: Output folder.
        config: Settings.
        live: Settings of the live reel.
        sound: See `reconstruct`.
        device: See `reconstruct`.
        progress: See `reconstruct`.
        present: See `reconstruct`.

    Raises:
        CaptureError: If the capture ends before its first frame.
    """
    capture = follower.capture
    check_capture(capture)
    check_networks(config.layering)
    check_memory(capture, config)
    config = with_former_defaults(config, recorded_settings(Path(out) / "work")).for_video(0)
    progress = progress or Silent()
    with RunLock(Path(out), run_record(capture, config, sound)) as lock:
        run = _LiveRun(follower, config, live, device, progress, Store(lock.work))
        first = next(iter(run.spans(0)), None)
        if first is None:
            raise CaptureError(f"{capture.path}: the capture ended without a frame. Record again.")
        job = run.job(config)
        rig, layout = prepare(job, capture, first.count // 2, lock)
        save_epochs(job.store, job.store.finished_groups(first_kept(job.store)) + first_kept(job.store))
        save_header(job, capture, rig, layout, None)
        writer = open_writer(job.store, lock.reel, config.encode, resume=True, first_group=first_kept(job.store))
        with LiveSoundtrack(lock.work, follower, sound, progress) as soundtrack:

            def shown(writer: ReelWriter, group: int | None) -> None:
                soundtrack.write(writer)
                present(writer, group)

            output = LiveOutput(writer, GroupWriter(writer, job.store), shown)
            run.make(rig, layout, output)
            soundtrack.finish(writer)
        present(writer, None)
        writer.finish()
        return Result(lock.reel, lock.work, job.store.seconds(), job.device_name)


@contextmanager
def _stop_on_error(follower: Follower) -> Iterator[None]:
    """Stop the follower after an error, so that no thread keeps waiting for frames."""
    try:
        yield
    except BaseException:
        follower.stop()
        raise


class _LiveRun:
    """Reconstruction of the groups of a live reel, in order. The checkpoints are those of any other run."""

    def __init__(
        self, follower: Follower, config: Config, live: Live, device: str, progress: Progress, store: Store
    ) -> None:
        size = follower.capture.width, follower.capture.height
        self.gpu, note = pick_gpu(device, largest_buffer(*size, config.keyframe.max_points))
        if note:
            progress.note(note)
        self.follower = follower
        self.config = config
        self.live = live
        self.progress = progress
        self.store = store
        fps = follower.capture.fps
        self.window = Window(store, None if live.keep is None else max(round(live.keep * fps), 1))
        self.lateness = Lateness(config, live.when_late, config.group.length / fps, progress)
        self.edge: np.ndarray | None = None

    def spans(self, first: int, skip: bool = False) -> LiveSpans:
        return LiveSpans(self.follower, self.config.group.length, self.config.group.overlap, first, skip)

    def job(self, config: Config) -> Job:
        return Job(config, self.progress, self.store, gpu=self.gpu)

    def make(self, rig: Rig, layout: Layout, output: LiveOutput) -> None:
        """Reconstruct all groups that are not finished. rig: state of the cameras at group 0."""
        before, done = self._restore(rig, output)
        skip = self.live.when_late == "skip"  # the next group is then chosen when the current one is finished
        live, taken = self.spans(done, skip), Queue[GroupSpan]()

        def stretches() -> Iterator[tuple[int, int]]:
            for span in live:
                taken.put(span)
                yield span.first, span.count

        capture, group = self.follower.capture, self.config.group
        names = before.rig.names
        with (
            FramePrefetcher(capture, names, stretches(), ahead=not skip, shared=group.overlap) as frames,
            _stop_on_error(self.follower),
        ):
            for images in frames:
                span = taken.get()
                for index in range(done, span.index):
                    before = self._skip_group(live.span(index), before, layout, output)
                before = self._reconstruct(span, images, before, layout, output, live)
                done = span.index + 1

    def _reconstruct(
        self, span: GroupSpan, frames: np.ndarray, before: Handover, layout: Layout, output: LiveOutput, live: LiveSpans
    ) -> Handover:
        settings = self.lateness.settings(span.index, live.seconds_behind(span))
        self.edge = frames[span.own].copy() if span.own < len(frames) else None
        before = self._begin_group(span, before)
        missing = self.follower.capture.missing(span.first, span.count, before.rig.names)
        before = run_group(self.job(settings), span, frames, before, layout, output, missing=missing)
        self.window.drop_old_groups(output.writer)
        self._report(span, live)
        return before

    def _skip_group(self, span: GroupSpan, before: Handover, layout: Layout, output: LiveOutput) -> Handover:
        """Write a skipped group."""
        before = self._begin_group(span, before)
        edge = self.edge if before.reference is None else before.reference
        if edge is None:
            edge = self.follower.capture.read(span.first, 1, before.rig.names)[0]
        before = write_skipped_group(self.job(self.config), span, before, edge, layout, output)
        self.window.drop_old_groups(output.writer)
        self.progress.note(f"Group {span.index + 1} skipped: nothing moves in it.")
        return before

    def _begin_group(self, span: GroupSpan, before: Handover) -> Handover:
        self.window.record_rig(span.index, before.rig)
        save_epochs(self.store, span.index)
        if starts_epoch(span.index):
            return replace(before, retired=trained_points(self.store, span.index - 1))
        return before

    def _restore(self, rig: Rig, output: LiveOutput) -> tuple[Handover, int]:
        """Return the state after the finished groups, and the number of the next group."""
        first, degree = first_kept(self.store), self.config.keyframe.sh_degree
        done = first + self.store.finished_groups(first)
        if done > first and self._has_grown(done - 1):
            done -= 1
            self.store.group(done).forget()
        rig = load_rig(self.store, rig)
        static = static_before(self.store, first, degree)
        before = Handover(rig, static, Gaussians.empty(degree))
        if first == 0:
            before = Handover(rig, static, seeds=self.store.initial_points())
        live = self.spans(first)
        output.restore_layers(self.store, first, live)
        for index in range(first, done):
            span = live.span(index)
            self.window.record_rig(index, before.rig)
            if starts_epoch(index):
                before = replace(before, static=static_before(self.store, index, degree))
            before = restore_group(self.job(self.config), span, before)
            output.restore(index, last=index + 1 == done)
        return before, done

    def _has_grown(self, group: int) -> bool:
        """Return whether a group was the last one when it was made, and more frames exist now."""
        span, frames = self.spans(group).span(group), self.store.group(group).group().group.frames
        return frames < span.count and self.follower.frames > span.first + frames

    def _report(self, span: GroupSpan, live: LiveSpans) -> None:
        since = self.follower.seconds_since(span.first + span.own - 1)
        latency = "" if since is None else f" {since:.1f} s after its last frame was filmed"
        if live.complete_count() > span.index + 1:
            state = f"{live.seconds_behind(span):.1f} s of later frames exist already"
        else:
            state = "the capture has ended" if self.follower.total is not None else "waiting for frames"
        self.progress.note(f"Group {span.index + 1} written{latency}; {state}.")


class LiveOutput(ReelOutput):
    """Output to a live reel. Layers are written with the group at which they are retired."""

    def _write_layer(self, layer: CompressedLayer) -> None:
        self._write_files(layer.group, layer.first_frame, layer.trained, layer.encoded)

    def _write_files(self, group: int, first_frame: int, points: Gaussians, encoded: EncodedLayer) -> None:
        self.writer.add_layer(group, first_frame, points, encoded=encoded, until=retirement_group(group))

    def restore_layers(self, store: Store, first: int, spans: LiveSpans) -> None:
        """Write the layers of earlier groups that the first kept group shows."""
        for index in range(first // EPOCH * EPOCH, first):
            layer = store.group(index).layer()
            if layer is not None and not self.writer.manifest.groups:
                frame, points = spans.span(index).first, layer.trained
                encoded = self.encoder.layer(index, frame, points, layer.importance, layer.steps)
                self._write_files(index, frame, points, encoded)
            self.group_writer.skip(index)

    def restore(self, index: int, last: bool) -> None:
        """See `Output`."""
        if index >= self.writer.manifest.first_group:
            super().restore(index, last)


def write_skipped_group(
    job: Job, span: GroupSpan, before: Handover, edge: np.ndarray, layout: Layout, output: Output
) -> Handover:
    """Write a group in which nothing moves, since a reel needs every frame. The next group starts from the same state.

    Args:
        job: The run.
        span: Frames of the group.
        before: State that the group before passed on.
        edge: Images [C, H, W, 3] uint8 of the last frame before the gap.
        layout: Measures of the scene.
        output: Destination of the group.
    """
    still, count = before.dynamic, span.count
    assert still is not None  # the first group of all is never skipped
    static = _rewrite_static(job, span, before, still, layout, output)
    dq = np.tile(np.array([1, 0, 0, 0], np.float32), (count, len(still), 1))
    light = np.tile(np.exp(before.rig.light), (count, 1)) if before.rig.light.any() else None
    group = Group(
        span.index, span.first, still, np.zeros((count, len(still), 3), np.float32), dq, static.alive, light=light
    )
    encoder = output.encoder
    with job.timed("encode"):
        importance = group_importance(output.header, encoder.config, static.points, group)[0]
        output.add_group(CompressedGroup(group, importance, STEPS, encoder.group(group, importance)))
    return Handover(before.rig, static, still, reference=edge)


def _rewrite_static(
    job: Job, span: GroupSpan, before: Handover, still: Gaussians, layout: Layout, output: Output
) -> StaticPoints:
    """Write the living static points again if their layers end at a skipped group. still: dynamic points of the group."""
    if before.retired is None:
        return before.static
    none = StaticPoints.none(job.config.keyframe.sh_degree)
    living = before.retired[before.static.alive]
    if not len(living):
        return none
    seen = Gaussians.concatenate([living, still])
    importance = weigh([seen], before.rig.cameras, layout.near, job.config.antialias)[: len(living)]
    encoded = output.encoder.layer(span.index, span.first, living, importance)
    layer = CompressedLayer.of(span, living, importance, STEPS, encoded)
    output.add_layer(layer)
    return none.with_layer(layer.decoded)


class LiveSpans:
    """Iterator over the groups of a growing capture. It waits for their frames until the capture ends.

    A group is yielded once at least one later frame exists, so that spans equal those of `group_spans`.

    Attributes:
        follower: The growing capture.
        length: Frames of a group.
        overlap: Frames shared with the next group.
    """

    def __init__(self, follower: Follower, length: int, overlap: int, first: int, skip: bool = False) -> None:
        """Prepare the iteration.

        Args:
            follower: The growing capture.
            length: Frames of a group.
            overlap: Frames shared with the next group.
            first: Number of the first group.
            skip: Skip groups if a later one is complete already. Group 0 and the groups after the end of the capture are never
                skipped.
        """
        self.follower = follower
        self.length = length
        self.overlap = overlap
        self._next = first
        self._skip = skip

    def __iter__(self) -> Iterator[GroupSpan]:
        """Yield groups as their frames arrive."""
        while (span := self._wait(self._next)) is not None:
            yield span
            self._next = span.index + 1

    def span(self, index: int) -> GroupSpan:
        """Return the span of a group that is not the last one."""
        return GroupSpan(index, index * self.length, self.length, self.length + self.overlap)

    def complete_count(self) -> int:
        """Return the number of groups that are complete so far."""
        total = self.follower.total
        if total is not None:
            return len(group_spans(total, self.length, self.overlap))
        return max((self.follower.frames - 1 - self.overlap) // self.length, 0)

    def seconds_behind(self, span: GroupSpan) -> float:
        """Return the seconds of video that exist after the end of a group."""
        return max(self.follower.frames - span.first - span.count, 0) / self.follower.capture.fps

    def _wait(self, index: int) -> GroupSpan | None:
        span = self.span(index)
        if self.follower.wait(span.first + span.count + 1):
            if self._skip and index > 0 and self.follower.total is None:
                return self.span(max(self.complete_count() - 1, index))
            return span
        total = self.follower.total
        if not total:
            return None  # stopped, or empty
        rest = group_spans(total, self.length, self.overlap)[index:]
        return rest[0] if rest else None
