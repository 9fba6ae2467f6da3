"""Reconstruction of a growing capture to a live reel. Each group is written as soon as it is trained.

Renewal: at each epoch all static layers retire together, and their living points are written again. Without this renewal, a late
viewer would have to download every static Gaussian ever created. Retention: groups outside a window are deleted from the reel and
the checkpoints.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Queue
from typing import Literal

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Progress, Silent
from splatreel.capture.follower import Follower
from splatreel.capture.reading import FramePrefetcher
from splatreel.codec.encoder import EncodedLayer
from splatreel.codec.predictive.precision import STEPS
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config
from splatreel.config.presets import DRAFT
from splatreel.config.settings import changed
from splatreel.method.algorithm import FirstGroup, NextGroup, Start
from splatreel.method.cameras.rig import Rig
from splatreel.method.encode.compression import CompressedGroup, CompressedLayer, group_importance, weigh
from splatreel.method.init.layout import Layout
from splatreel.run.groups import restore_group, run_group
from splatreel.run.job import Job
from splatreel.run.jobs import ChapteredRun
from splatreel.run.live.live_soundtrack import LiveSoundtrack
from splatreel.run.output.group_output import Output, ReelOutput
from splatreel.run.output.group_writer import GroupWriter, PresentationHook, no_presentation, open_writer
from splatreel.run.pipeline import Result, plan_run, result_of
from splatreel.run.preparation import prepare, save_header
from splatreel.run.run_folder import RunLock
from splatreel.run.store import Store, load_arrays, save_arrays
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group, GroupSpan, group_spans

WhenLate = Literal["wait", "draft", "skip"]
"""wait: reconstruct every group in order, with growing latency. draft: use draft settings until caught up. skip: skip groups."""

DRAFT_SETTINGS = ("keyframe.refine_iterations", "group.iterations_per_frame")
"""Settings of later groups that draft lowers."""


class Lateness:
    """Latency of a live run. It is late if another group's frames exist before a group begins, and caught up if none do.

    Attributes:
        when_late: Reaction to lateness.
        length: Length of a group, seconds.
        late: Whether the run is late.
    """

    def __init__(self, config: Config, when_late: WhenLate, length: float, progress: Progress) -> None:
        self.config = config
        self.when_late = when_late
        self.length = length
        self._progress = progress
        self.late = False
        self._draft = drafted(config)

    def settings(self, group: int, behind: float) -> Config:
        """Return the settings of a group, and report a change of lateness.

        Args:
            group: Number of the group.
            behind: Seconds of video that exist after the end of the group.
        """
        if not self.late and behind > self.length:
            self.late = True
            self._progress.note(
                f"Too slow: group {group + 1} starts {behind:.1f} s late{self._advice()} (--when-late {self.when_late})."
            )
        elif self.late and behind == 0:
            self.late = False
            self._progress.note(f"Group {group + 1}: caught up.")
        return self._draft if self.late and self.when_late == "draft" else self.config

    def _advice(self) -> str:
        if self.when_late == "skip":
            return "; the frames filmed meanwhile are skipped"
        if self.when_late == "draft" and self._draft != self.config:
            return "; draft settings are used until it has caught up"
        if self.when_late == "draft":
            return "; it uses draft settings already. Choose a smaller --width, or --when-late skip"
        return "; latency grows"


def drafted(config: Config) -> Config:
    """Return settings with at most the iterations of draft."""
    values = {"keyframe.refine_iterations": config.keyframe.refine_iterations}
    values["group.iterations_per_frame"] = config.group.iterations_per_frame
    return changed(config, {name: min(values[name], DRAFT[name]) for name in DRAFT_SETTINGS})


EPOCH = 64
"""Groups per epoch. Each epoch starts with a renewal."""


def starts_epoch(group: int) -> bool:
    """Return whether all earlier layers retire at a group."""
    return group > 0 and group % EPOCH == 0


def retirement_group(group: int) -> int:
    """Return the group at which the layers born at a group retire."""
    return (group // EPOCH + 1) * EPOCH


def save_epochs(store: Store, group: int) -> None:
    """Save the first groups of all epochs up to a group, for readers of the checkpoints."""
    store.save_chapter_firsts(list(range(0, retirement_group(group) + 1, EPOCH)))


def trained_points(store: Store, group: int) -> Gaussians:
    """Return all static points at the end of a group, as trained.

    Renewal encodes these, since coding decoded points again would lose quality each time.
    """
    return Gaussians.concatenate([Gaussians.empty(0), *(layer.trained for _, layer in store.layers(group))])


def static_before(store: Store, group: int, sh_degree: int) -> StaticPoints:
    """Return the static points at the start of a group, all alive."""
    if group == 0 or starts_epoch(group):
        return StaticPoints.none(sh_degree)
    return StaticPoints.none(sh_degree).with_layer(store.static(group - 1))


class Window:
    """Window of the groups that are kept.

    The state of the cameras at the first kept group is saved before anything is deleted. Static layers are kept as long as a
    kept group shows them.

    Attributes:
        frames: Number of frames that are kept; None keeps all.
    """

    def __init__(self, store: Store, frames: int | None) -> None:
        self.store = store
        self.frames = frames
        self._rigs: deque[tuple[int, Rig]] = deque()

    def record_rig(self, group: int, rig: Rig) -> None:
        """Record the rig at the start of a group."""
        if self.frames is not None:
            self._rigs.append((group, rig))

    def drop_old_groups(self, writer: ReelWriter) -> None:
        """Delete groups outside the window, after a group was written."""
        manifest = writer.manifest
        if self.frames is None or not manifest.groups:
            return
        oldest = manifest.frames - self.frames
        first = next(entry.group for entry in manifest.groups if entry.end > oldest)
        writer.drop_before(first)
        self.drop_before(writer.manifest.first_group)

    def drop_before(self, first: int) -> None:
        """Delete the checkpoints of earlier groups, except for layers that later groups show."""
        while self._rigs and self._rigs[0][0] < first:
            self._rigs.popleft()
        if first <= first_kept(self.store) or not self._rigs:
            return
        save_rig(self.store, first, self._rigs[0][1])
        epoch = first // EPOCH * EPOCH
        for folder in self.store.work.glob("group[0-9]*"):
            group = int(folder.name.removeprefix("group"))
            if group < first:
                _empty(folder, {"layer.safetensors"} if group >= epoch else set(), group)


def _empty(folder: Path, kept: set[str], group: int) -> None:
    """Delete the checkpoints of a group except for the named files. The poses in group 0 are kept too."""
    kept = kept | {"poses.safetensors"} if group == 0 else kept
    for file in folder.glob("*"):
        if file.name not in kept:
            file.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()


def first_kept(store: Store) -> int:
    """Return the first group whose checkpoints are kept."""
    path = _file(store)
    return int(load_arrays(path)["group"][0]) if path.exists() else 0


def save_rig(store: Store, group: int, rig: Rig) -> None:
    """Save the cameras' state at the start of a group, so that no earlier group is needed."""
    ends = np.stack(rig.ends) if rig.ends else np.zeros((0, len(rig.cameras)))
    arrays = {
        "group": np.array([group]),
        "gains": rig.gains,
        "exposure": rig.exposure,
        "light": rig.light,
        "ends": ends,
    }
    save_arrays(_file(store), arrays | {"viewmats": np.stack([camera.viewmat for camera in rig.cameras])})


def load_rig(store: Store, rig: Rig) -> Rig:
    """Return the rig at the first kept group. rig: initial rig without excluded cameras."""
    path = _file(store)
    if not path.exists():
        return rig
    arrays = load_arrays(path)
    pairs = zip(rig.cameras, arrays["viewmats"], strict=True)
    return replace(
        rig,
        cameras=[replace(camera, viewmat=viewmat) for camera, viewmat in pairs],
        gains=arrays["gains"],
        exposure=arrays["exposure"],
        light=arrays["light"],
        ends=tuple(arrays["ends"]),
    )


def _file(store: Store) -> Path:
    return store.work / "first.safetensors"


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
    """Reconstruct a capture while it is being written, until it ends. Another call continues. Other arguments: see `reconstruct`.

    Raises:
        CaptureError: If the capture ends before its first frame.
    """
    capture, progress = follower.capture, progress or Silent()
    planned = plan_run(capture, out, config, sound=sound, device=device)
    with RunLock(planned.out, planned.record) as lock:
        run = _LiveRun(follower, planned, live, progress)
        first = next(iter(run.spans(0)), None)
        if first is None:
            raise CaptureError(f"{capture.path}: the capture ended without a frame. Record again.")
        job = run.job(planned.config)
        rig, layout = prepare(job, capture, first.count // 2, lock)
        save_epochs(job.store, job.store.finished_groups(first_kept(job.store)) + first_kept(job.store))
        save_header(job, capture, rig, layout, None)
        writer = open_writer(job.store, lock.reel, run.config.encode, resume=True, first_group=first_kept(job.store))
        with LiveSoundtrack(lock.work, follower, sound, progress) as soundtrack:

            def shown(writer: ReelWriter, group: int | None) -> None:
                soundtrack.write(writer)
                present(writer, group)

            output = LiveOutput(writer, GroupWriter(writer, job.store), shown)
            run.make(rig, layout, output)
            soundtrack.finish(writer)
        present(writer, None)
        writer.finish()
        return result_of(planned)


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

    def __init__(self, follower: Follower, planned: ChapteredRun, live: Live, progress: Progress) -> None:
        if planned.gpu_note:
            progress.note(planned.gpu_note)
        self.gpu, self.store = planned.gpu, planned.store
        self.config = config = planned.config
        self.follower = follower
        self.live = live
        self.progress = progress
        fps = follower.capture.fps
        self.window = Window(self.store, None if live.keep is None else max(round(live.keep * fps), 1))
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
        self, span: GroupSpan, frames: np.ndarray, before: Start, layout: Layout, output: LiveOutput, live: LiveSpans
    ) -> NextGroup:
        settings = self.lateness.settings(span.index, live.seconds_behind(span))
        self.edge = frames[span.own].copy() if span.own < len(frames) else None
        before = self._begin_group(span, before)
        missing = self.follower.capture.missing(span.first, span.count, before.rig.names)
        before = run_group(self.job(settings), span, frames, before, layout, output, missing=missing)
        self.window.drop_old_groups(output.writer)
        self._report(span, live)
        return before

    def _skip_group(self, span: GroupSpan, before: Start, layout: Layout, output: LiveOutput) -> NextGroup:
        """Write a skipped group."""
        before = self._begin_group(span, before)
        assert isinstance(before, NextGroup)  # the first group of all is never skipped
        edge = self.edge if before.reference is None else before.reference
        if edge is None:
            edge = self.follower.capture.read(span.first, 1, before.rig.names)[0]
        before = write_skipped_group(self.job(self.config), span, before, edge, layout, output)
        self.window.drop_old_groups(output.writer)
        self.progress.note(f"Group {span.index + 1} skipped: nothing moves in it.")
        return before

    def _begin_group(self, span: GroupSpan, before: Start) -> Start:
        self.window.record_rig(span.index, before.rig)
        save_epochs(self.store, span.index)
        if isinstance(before, NextGroup) and starts_epoch(span.index):
            return replace(before, retired=trained_points(self.store, span.index - 1))
        return before

    def _restore(self, rig: Rig, output: LiveOutput) -> tuple[Start, int]:
        """Return the state after the finished groups, and the number of the next group."""
        first, degree = first_kept(self.store), self.config.keyframe.sh_degree
        done = first + self.store.finished_groups(first)
        if done > first and self._has_grown(done - 1):
            done -= 1
            self.store.group(done).forget()
        rig = load_rig(self.store, rig)
        static = static_before(self.store, first, degree)
        before: Start = NextGroup(rig, static, Gaussians.empty(degree))
        if first == 0:
            before = FirstGroup(rig, static, self.store.initial_points())
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
    job: Job, span: GroupSpan, before: NextGroup, edge: np.ndarray, layout: Layout, output: Output
) -> NextGroup:
    """Write a group in which nothing moves, since a reel needs every frame. The next group starts from the same state.

    `edge` has the images [C, H, W, 3] uint8 of the last frame before the gap.
    """
    still, count = before.dynamic, span.count
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
    return NextGroup(before.rig, static, still, reference=edge)


def _rewrite_static(
    job: Job, span: GroupSpan, before: NextGroup, still: Gaussians, layout: Layout, output: Output
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
