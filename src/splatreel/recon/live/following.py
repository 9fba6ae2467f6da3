"""From a capture that is still being written to a live reel: each group is shown as soon as it can be."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Queue

import numpy as np
import torch

from splatreel.capture.follower import Follower
from splatreel.capture.prefetch import FramePrefetcher
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config
from splatreel.errors import CaptureError
from splatreel.progress import Progress, Silent
from splatreel.recon.cameras.rig import Rig
from splatreel.recon.encode.header import open_writer
from splatreel.recon.encode.publisher import Present, Publisher, nothing_more
from splatreel.recon.groups import reconstruct_group, restore_group
from splatreel.recon.init.layout import Layout
from splatreel.recon.live.held import hold_group
from splatreel.recon.live.lateness import Lateness, WhenLate
from splatreel.recon.live.output import LiveOutput
from splatreel.recon.live.renewal import is_renewed, keep_epochs, static_before, trained_points
from splatreel.recon.live.sound import LiveSound
from splatreel.recon.live.spans import LiveSpans
from splatreel.recon.live.window import Window, first_kept, load_rig
from splatreel.recon.pipeline import Result
from splatreel.recon.preparation import prepare, save_header
from splatreel.recon.run.device import pick_device
from splatreel.recon.run.job import Job
from splatreel.recon.run.memory import check_memory
from splatreel.recon.run.requirements import check_capture
from splatreel.recon.run.run_lock import RunLock
from splatreel.recon.run.store import Store
from splatreel.recon.stages.stage import AfterGap, FirstOfVideo, Handover, NextGroup, RetiredStatic
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.spans import GroupSpan


@dataclass(frozen=True)
class Live:
    """How a live reel is made. when_late: what to do when groups take longer than they last. keep: seconds that the reel keeps; None:
    all."""

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
    present: Present = nothing_more,
) -> Result:
    """Reconstruct a capture while it is being written, until it has ended; the same call continues, with the frames added since.

    Everything else is as in `reconstruct`. Raises `CaptureError` for a capture that ends before its first frame.
    """
    capture = follower.capture
    check_capture(capture)
    check_memory(capture, config)
    chosen, progress = pick_device(device), progress or Silent()
    with RunLock(Path(out), capture, config, sound) as lock:
        run = _LiveRun(follower, config, live, chosen, progress, Store(lock.work))
        first = next(iter(run.spans(0)), None)
        if first is None:
            raise CaptureError(f"{capture.path}: has no frame. Record again.")
        job = run.job(config)
        rig, layout = prepare(job, capture, first.count // 2, lock)
        keep_epochs(job.store, job.store.finished_groups(first_kept(job.store)) + first_kept(job.store))
        save_header(job, capture, rig, layout, None)
        writer = open_writer(job.store, lock.reel, config.encode, resume=True, first_group=first_kept(job.store))
        with LiveSound(lock.work, follower, sound, progress) as heard:

            def shown(writer: ReelWriter, group: int | None) -> None:
                heard.publish(writer)
                present(writer, group)

            output = LiveOutput(writer, Publisher(writer, job.store, chosen), shown)
            run.make(rig, layout, output)
            heard.finish(writer)
        present(writer, None)
        writer.finish()
        return Result(lock.reel, lock.work, job.store.seconds(), chosen.type)


@contextmanager
def _stopping(follower: Follower) -> Iterator[None]:
    """After an error nobody waits for frames any more, a thread that decodes them neither."""
    try:
        yield
    except BaseException:
        follower.stop()
        raise


class _LiveRun:
    """The groups of a live reel, in order. What a group is made of is in its checkpoints as of any other run."""

    def __init__(
        self, follower: Follower, config: Config, live: Live, device: torch.device, progress: Progress, store: Store
    ) -> None:
        self.follower, self.config, self.live = follower, config, live
        self.device, self.progress, self.store = device, progress, store
        fps = follower.capture.fps
        self.window = Window(store, None if live.keep is None else max(round(live.keep * fps), 1))
        self.lateness = Lateness(config, live.when_late, config.group.length / fps, progress)
        self.edge: np.ndarray | None = None

    def spans(self, first: int, skip: bool = False) -> LiveSpans:
        return LiveSpans(self.follower, self.config.group.length, self.config.group.overlap, first, skip)

    def job(self, config: Config) -> Job:
        return Job(config, self.device, self.progress, self.store)

    def make(self, rig: Rig, layout: Layout, output: LiveOutput) -> None:
        """All groups that are not finished, as they can be made. rig: as the first group of all finds it."""
        before, done = self._restore(rig, output)
        skip = self.live.when_late == "skip"  # which group is next is then known when the one before is finished
        live, taken = self.spans(done, skip), Queue[GroupSpan]()

        def stretches() -> Iterator[tuple[int, int]]:
            for span in live:
                taken.put(span)
                yield span.first, span.count

        capture, group = self.follower.capture, self.config.group
        names = before.rig.names
        with (
            FramePrefetcher(capture, names, stretches(), ahead=not skip, shared=group.overlap) as frames,
            _stopping(self.follower),
        ):
            for pictures in frames:
                span = taken.get()
                for index in range(done, span.index):
                    before = self._hold(live.span(index), before, layout, output)
                before = self._reconstruct(span, pictures, before, layout, output, live)
                done = span.index + 1

    def _reconstruct(
        self, span: GroupSpan, frames: np.ndarray, before: Handover, layout: Layout, output: LiveOutput, live: LiveSpans
    ) -> Handover:
        settings = self.lateness.settings(span.index, live.behind(span))
        self.edge = frames[span.own].copy() if span.own < len(frames) else None
        before = self._begin(span, before)
        before = reconstruct_group(self.job(settings), span, frames, before, layout, output)
        self.window.move(output.writer)
        self._tell(span, live)
        return before

    def _hold(self, span: GroupSpan, before: Handover, layout: Layout, output: LiveOutput) -> Handover:
        """A group that is left out."""
        before = self._begin(span, before)
        assert isinstance(before, NextGroup)  # the first group of all is never left out
        edge = before.reference if isinstance(before, AfterGap) else self.edge
        if edge is None:
            edge = self.follower.capture.read(span.first, 1, before.rig.names)[0]
        before = hold_group(self.job(self.config), span, before, edge, layout, output)
        self.window.move(output.writer)
        self.progress.note(f"Group {span.index + 1} is left out: nothing moves in it.")
        return before

    def _begin(self, span: GroupSpan, before: Handover) -> Handover:
        self.window.begins(span.index, before.rig)
        keep_epochs(self.store, span.index)
        if is_renewed(span.index):
            static, trained = before.static, trained_points(self.store, span.index - 1)
            return replace(before, static=RetiredStatic(static.points, static.alive, trained))
        return before

    def _restore(self, rig: Rig, output: LiveOutput) -> tuple[Handover, int]:
        """What the groups that are finished hand over, and the number of the next one."""
        first, degree = first_kept(self.store), self.config.keyframe.sh_degree
        done = first + self.store.finished_groups(first)
        if done > first and self._went_on(done - 1):
            done -= 1
            self.store.group(done).forget()
        rig = load_rig(self.store, rig)
        static = static_before(self.store, first, degree)
        before: Handover = NextGroup(rig, static, Gaussians.empty(degree), None) if first else FirstOfVideo(rig, static)
        live = self.spans(first)
        output.restore_layers(self.store, first, live)
        for index in range(first, done):
            span = live.span(index)
            self.window.begins(index, before.rig)
            if is_renewed(index):
                before = replace(before, static=static_before(self.store, index, degree))
            before = restore_group(self.job(self.config), span, before)
            output.restore(index, last=index + 1 == done)
        return before, done

    def _went_on(self, group: int) -> bool:
        """Whether a group was the last one when it was made, and is not any more."""
        span, frames = self.spans(group).span(group), self.store.group(group).group().group.frames
        return frames < span.count and self.follower.frames > span.first + frames

    def _tell(self, span: GroupSpan, live: LiveSpans) -> None:
        since = self.follower.seconds_since(span.first + span.own - 1)
        shown = "" if since is None else f" {since:.1f} s after its last frame was filmed"
        if live.complete() > span.index + 1:
            state = f"{live.behind(span):.1f} s more are there already"
        else:
            state = "all is shown" if self.follower.total is not None else "waiting for frames"
        self.progress.note(f"Group {span.index + 1} shown{shown}; {state}.")
