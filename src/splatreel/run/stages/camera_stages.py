"""Stages that look at the cameras: exposures and poses."""

from __future__ import annotations

from dataclasses import replace

from splatreel.config import Config
from splatreel.method.cameras.exposure import (
    Exposure,
    at_next_keyframe,
    measure_exposure,
    remove_exposure,
    report_exposure,
)
from splatreel.method.cameras.rig import Poses, Rig, check_later_poses
from splatreel.run.checkpoint import Arrays, present
from splatreel.run.stages.stage import AfterGap, GroupState, Stage
from splatreel.run.store import GroupStore
from splatreel.run.workload import Workload


class EvenExposures(Stage[Exposure]):
    """Measures how exposures and light change during the group, and removes the changes from the images."""

    name = "exposure"
    label = "exposures and poses"
    checkpoint = "exposure"

    def is_needed(self, state: GroupState) -> bool:
        """Return True if exposures are evened at all."""
        return state.job.config.even_exposure

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return seconds that grow with the number of pixels."""
        return 0.007 * work.decoded(frames) * config.even_exposure

    def run(self, state: GroupState) -> Exposure:
        """Compare all frames with the keyframe, with the plates of a chapter, or with the frame before a gap."""
        if state.plates is not None:
            return measure_exposure(state.rig.evened(), state.data.images, state.plates)
        reference = state.start.reference if isinstance(state.start, AfterGap) else None
        return measure_exposure(state.rig, state.data.images, reference)

    def apply(self, state: GroupState, found: Exposure) -> None:
        """Even the images out, and move the exposures of the rig on to the next keyframe."""
        report_exposure(state.rig, found, state.job.progress)
        remove_exposure(state.data.images, found, keep_white=bool(state.data.layout.backgrounds))
        state.rig = at_next_keyframe(state.rig, found, state.span.own)
        state.data = replace(state.data, light=found.light_factors)

    def pack(self, found: Exposure) -> Arrays:
        """Return the exposures as arrays."""
        return {"change": found.change, "light": found.light}

    def unpack(self, arrays: Arrays) -> Exposure:
        """Return the exposures from arrays."""
        return Exposure(arrays["change"], arrays["light"])

    def restore_rig(self, rig: Rig, store: GroupStore, own: int) -> Rig:
        """Return the rig with its exposures at the next keyframe."""
        found = self.load(store)
        return rig if found is None else at_next_keyframe(rig, found, own)


class CheckPoses(Stage[Poses]):
    """Corrects the poses of cameras that were moved since the group before."""

    name = "poses"
    label = "exposures and poses"
    checkpoint = "poses"

    def is_needed(self, state: GroupState) -> bool:
        """Return True if poses are checked at all. A subject alone has too few features for it."""
        return state.job.config.check_poses and not (state.data.layout.backgrounds and state.span.index)

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        """Return seconds that grow with the number of cameras."""
        return 0.04 * work.cameras * config.check_poses

    def run(self, state: GroupState) -> Poses:
        """Check the poses at the first and the middle frame."""
        images = state.data.images
        return check_later_poses(state.rig, images[[0, len(images) // 2]], state.job.progress)

    def apply(self, state: GroupState, found: Poses) -> None:
        """Correct the cameras."""
        state.rig = state.rig.with_poses(found)

    def pack(self, found: Poses) -> Arrays:
        """Return the poses as arrays."""
        return {"viewmats": found.viewmats} | present(kept=found.kept)

    def unpack(self, arrays: Arrays) -> Poses:
        """Return the poses from arrays."""
        return Poses(arrays["viewmats"], arrays.get("kept"))

    def restore_rig(self, rig: Rig, store: GroupStore, own: int) -> Rig:
        """Return the rig with corrected poses."""
        found = self.load(store)
        return rig if found is None else rig.with_poses(found)


def save_poses(store: GroupStore, poses: Poses) -> None:
    """Save the poses of the first frame, which are checked before the first group."""
    CheckPoses().save(store, poses)


def load_poses(store: GroupStore) -> Poses | None:
    """Return saved poses; None where there are none."""
    return CheckPoses().load(store)
