"""Stages that train the keyframe of a group: one for the first group of a video, one for that of a chapter, one for all others."""

from __future__ import annotations

from dataclasses import replace

from splatreel.config import Config
from splatreel.method.cameras.rig import Rig
from splatreel.method.train.chapter_keyframe import ChapterStart, start_chapter
from splatreel.method.train.keyframe import GAINS_EVERY, KeyframeResult
from splatreel.method.train.training import train_first_keyframe, train_keyframe
from splatreel.run import checkpoint
from splatreel.run.checkpoint import Arrays
from splatreel.run.output.keyframe_preview import KeyframePreview
from splatreel.run.stages.stage import FirstOfChapter, FirstOfVideo, GroupState, NextGroup, Stage
from splatreel.run.store import GroupStore
from splatreel.run.workload import Workload

CHAPTER_SHARE = 0.5
"""Time of the first keyframe of a chapter, as a share of that of a video: it trains only points that the shared scene lacks."""


class FirstKeyframe(Stage[KeyframeResult]):
    """Trains all points of the first keyframe of a video from the initial points."""

    name = "keyframe"
    text = "training the first keyframe"
    label = "keyframes"
    checkpoint = "keyframe"
    starts = (FirstOfVideo,)
    trains = True

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return the seconds of all iterations, many of which use smaller images."""
        keyframe = config.keyframe
        pixels = work.training_share(config, keyframe.coarse_share)
        return keyframe.first_iterations * work.full_iteration(config, pixels) + _mean_seconds(work, frames, config)

    def steps(self, state: GroupState) -> int:
        """Return the number of iterations."""
        return state.job.config.keyframe.first_iterations

    def run(self, state: GroupState) -> KeyframeResult:
        """Train all points."""
        job = state.job
        preview = KeyframePreview(job.store)
        initial = job.store.initial_points()
        found = train_first_keyframe(state.data, *initial, job.config, job.progress, watch=preview.show)
        found.points.check_finite(f"Keyframe {state.span.index}")
        preview.finish(found.points)
        return found

    def apply(self, state: GroupState, found: KeyframeResult) -> None:
        """Take over the points and the color gains of the cameras."""
        state.points, state.rig = found.points, replace(state.rig, gains=found.gains)

    def pack(self, found: KeyframeResult) -> Arrays:
        """Return the keyframe as arrays."""
        return checkpoint.pack(found.points) | {"gains": found.gains}

    def unpack(self, arrays: Arrays) -> KeyframeResult:
        """Return the keyframe from arrays."""
        return KeyframeResult(checkpoint.unpack(arrays), arrays["gains"])

    def restore_rig(self, rig: Rig, store: GroupStore, own: int) -> Rig:
        """Return the rig with the learned color gains."""
        found = self.load(store)
        return rig if found is None else replace(rig, gains=found.gains)


class LaterKeyframe(FirstKeyframe):
    """Trains the dynamic points at the keyframe of a later group, in front of frozen static points."""

    text = "training the keyframe"
    starts = (NextGroup,)

    def is_needed(self, state: GroupState) -> bool:
        """Return True if there are dynamic points."""
        return len(state.points) > 0

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return the seconds of all iterations, few of which compare whole images."""
        megapixels = work.megapixels * work.training_share(config, 0.0)
        iteration = 0.152 / GAINS_EVERY * megapixels + 0.0012 * work.dynamic(config)
        return config.keyframe.refine_iterations * iteration + _mean_seconds(work, frames, config)

    def steps(self, state: GroupState) -> int:
        """Return the number of iterations."""
        return state.job.config.keyframe.refine_iterations

    def run(self, state: GroupState) -> KeyframeResult:
        """Train the dynamic points."""
        found = train_keyframe(state.data, state.points, state.static, state.job.config, state.job.progress)
        found.points.check_finite(f"Keyframe {state.span.index}")
        return found

    def restore_rig(self, rig: Rig, store: GroupStore, own: int) -> Rig:
        """Return the rig as it is: `FirstKeyframe` reads the same checkpoint."""
        return rig


class ChapterKeyframe(Stage[ChapterStart]):
    """Trains the points that the first frame of a chapter shows and the shared static points lack."""

    name = "keyframe"
    text = "training the first keyframe of the chapter"
    label = "keyframes"
    checkpoint = "chapter"
    starts = (FirstOfChapter,)
    trains = True

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return a share of the seconds of the first keyframe of a video."""
        mean = _mean_seconds(work, frames, config)
        return CHAPTER_SHARE * (FirstKeyframe().seconds(work, frames, config) - mean) + mean

    def steps(self, state: GroupState) -> int:
        """Return the number of iterations."""
        return state.job.config.keyframe.first_iterations

    def run(self, state: GroupState) -> ChapterStart:
        """Take out wrong static points, and train new points."""
        found = start_chapter(state.data, state.static, state.job.config, state.job.progress)
        state.job.progress.update(self.steps(state), points=len(found.points))
        found.points.check_finite(f"Chapter of group {state.span.index}")
        return found

    def apply(self, state: GroupState, found: ChapterStart) -> None:
        """Take over the points, the color gains, and which static points are left."""
        state.points, state.rig = found.points, replace(state.rig, gains=found.gains)
        state.static = state.static.with_alive(found.alive)

    def pack(self, found: ChapterStart) -> Arrays:
        """Return the keyframe as arrays."""
        return checkpoint.pack(found.points) | {"gains": found.gains, "alive": found.alive}

    def unpack(self, arrays: Arrays) -> ChapterStart:
        """Return the keyframe from arrays."""
        return ChapterStart(checkpoint.unpack(arrays), arrays["gains"], arrays["alive"])

    def restore_rig(self, rig: Rig, store: GroupStore, own: int) -> Rig:
        """Return the rig with the learned color gains."""
        found = self.load(store)
        return rig if found is None else replace(rig, gains=found.gains)


def _mean_seconds(work: Workload, frames: int, config: Config) -> float:
    """Return the seconds of the temporal mean of the images."""
    return 0.02 * work.decoded(frames) if config.keyframe.temporal_mean else 0.0
