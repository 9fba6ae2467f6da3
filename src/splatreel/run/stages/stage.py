"""Base class of the stages that reconstruct a group, and the state that they share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import ClassVar, Generic, TypeVar

import numpy as np

from splatreel.config import Config
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.rig import Rig
from splatreel.method.layering.labels import Layers
from splatreel.method.tracking.tracking import GroupStart, VelocityPrior
from splatreel.method.train.group import GroupResult
from splatreel.run.checkpoint import Arrays
from splatreel.run.job import Job
from splatreel.run.output.group_output import Output
from splatreel.run.store import GroupStore
from splatreel.run.workload import Workload
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.spans import GroupSpan
from splatreel.scene.static_points import StaticPoints

Found = TypeVar("Found")


@dataclass(frozen=True)
class FirstOfVideo:
    """State before the first group of a video of one chapter: no point is known.

    Attributes:
        rig: Cameras as the first frame shows them.
        static: Static points, none.
    """

    rig: Rig
    static: StaticPoints


@dataclass(frozen=True)
class FirstOfChapter:
    """State before the first group of a chapter.

    Attributes:
        rig: Cameras as the shared scene found them.
        static: Static points that all chapters share, decoded.
    """

    rig: Rig
    static: StaticPoints


@dataclass(frozen=True)
class NextGroup:
    """State passed from one group to the next, evaluated at the next group's keyframe.

    Attributes:
        rig: Cameras as they are known so far.
        static: All static points so far, decoded.
        dynamic: Dynamic points of the last group, deformed to the keyframe (paper section 4).
        velocity: Motion of these points at the keyframe; None after a group without motion.
    """

    rig: Rig
    static: StaticPoints
    dynamic: Gaussians
    velocity: VelocityPrior | None


@dataclass(frozen=True)
class AfterGap(NextGroup):
    """State passed over groups that were left out.

    Attributes:
        reference: Images [C, H, W, 3] uint8 of the last frame before the gap. The exposures of `rig` belong to them.
    """

    reference: np.ndarray


Handover = FirstOfVideo | FirstOfChapter | NextGroup


@dataclass(frozen=True)
class RetiredStatic(StaticPoints):
    """Static points whose layers end at a group. The group writes the points that are still there again.

    Attributes:
        trained: The same points [S] before encoding.
    """

    trained: Gaussians

    def reissue(self, layers: Layers) -> tuple[Layers, StaticPoints]:
        """Return all resting points as new static points, and no older ones."""
        settled = Gaussians.concatenate([self.trained[layers.alive], layers.settled])
        none = StaticPoints(self.points[:0], np.zeros(0, bool))
        return replace(layers, settled=settled, alive=none.alive), none


@dataclass
class GroupState:
    """A group while its stages reconstruct it. Each stage reads and replaces fields.

    Attributes:
        job: The run.
        start: State that the group began with.
        data: Images and cameras of the group.
        output: Destination of the finished layer and group.
        plates: Images [C, H, W, 3] uint8 that the exposures of a chapter are measured against; None outside of chapters.
        static: Static points so far.
        points: Points at the keyframe that are not static so far.
        layers: Result of layering.
        tracks: Points and tracks that motion training starts from.
        motion: Result of motion training.
        group: The finished group.
    """

    job: Job
    start: Handover
    data: GroupInput
    output: Output
    plates: np.ndarray | None
    static: StaticPoints = field(init=False)
    points: Gaussians = field(init=False)
    layers: Layers = field(init=False)
    tracks: GroupStart = field(init=False)
    motion: GroupResult = field(init=False)
    group: Group = field(init=False)

    def __post_init__(self) -> None:
        """Take points over from the start."""
        self.static = self.start.static
        if isinstance(self.start, NextGroup):
            self.points = self.start.dynamic

    @property
    def span(self) -> GroupSpan:
        """Frames of the group."""
        return self.data.span

    @property
    def store(self) -> GroupStore:
        """Checkpoints of the group."""
        return self.job.store.group(self.span.index)

    @property
    def rig(self) -> Rig:
        """Cameras as they are known so far."""
        return self.data.rig

    @rig.setter
    def rig(self, rig: Rig) -> None:
        self.data = replace(self.data, rig=rig)


class Stage(ABC, Generic[Found]):
    """One stage of the reconstruction of a group. Its result is saved at once; a stage that is run again loads it.

    Attributes:
        name: Key in the seconds of a run. Several stages may share one.
        text: Text of the progress display; empty for a stage that is not shown.
        label: Name of the stage in an estimate of the seconds.
        checkpoint: Name of the file that holds the result; empty for a stage that is always run.
        starts: States that a group may have begun with for the stage to apply.
        trains: True if the stage trains on the GPU where there is one.
    """

    name: ClassVar[str]
    text: ClassVar[str] = ""
    label: ClassVar[str]
    checkpoint: ClassVar[str] = ""
    starts: ClassVar[tuple[type, ...]] = (FirstOfVideo, FirstOfChapter, NextGroup)
    trains: ClassVar[bool] = False

    def is_needed(self, state: GroupState) -> bool:
        """Return True if the stage has something to do for a group."""
        return True

    @abstractmethod
    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return the expected seconds on one thread of the machine that was measured.

        Args:
            work: Properties of the capture.
            frames: Frames of the group, overlap included.
            config: Settings of the run.
        """

    def steps(self, state: GroupState) -> int:
        """Return the number of steps of the progress bar."""
        return 1

    @abstractmethod
    def run(self, state: GroupState) -> Found:
        """Compute the result."""

    def apply(self, state: GroupState, found: Found) -> None:
        """Put the result, computed or loaded, into the state of the group."""

    def pack(self, found: Found) -> Arrays:
        """Return the result as the arrays of a checkpoint. Only stages with a checkpoint implement this."""
        raise NotImplementedError

    def unpack(self, arrays: Arrays) -> Found:
        """Return the result from the arrays of a checkpoint. Only stages with a checkpoint implement this."""
        raise NotImplementedError

    def restore_rig(self, rig: Rig, store: GroupStore, own: int) -> Rig:
        """Return the cameras with the findings of a finished stage.

        Args:
            rig: Cameras as the group found them.
            store: Checkpoints of the group.
            own: Number of frames of the group without the overlap.
        """
        return rig

    def load(self, store: GroupStore) -> Found | None:
        """Return the saved result; None where there is none."""
        arrays = store.load(self.checkpoint) if self.checkpoint else None
        return None if arrays is None else self.unpack(arrays)

    def save(self, store: GroupStore, found: Found) -> None:
        """Save a result, for a stage that has a checkpoint."""
        if self.checkpoint:
            store.save(self.checkpoint, self.pack(found))

    def execute(self, state: GroupState) -> None:
        """Load the result, or compute and save it; then put it into the state of the group."""
        if not isinstance(state.start, self.starts) or not self.is_needed(state):
            return
        with state.job.timed(self.name):
            found = self.load(state.store)
            if found is None:
                if self.text:
                    state.job.show(self.text, self.steps(state), state.span)
                found = self.run(state)
                self.save(state.store, found)
            self.apply(state, found)
