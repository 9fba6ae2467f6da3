"""Findings about the training cameras that are passed from group to group: poses, color gains, exposures, light, time offsets."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splatreel.base.progress import Progress
from splatreel.method.cameras.poses import PoseFindings, inspect_poses
from splatreel.method.cameras.time_offsets import CERTAIN, LearnedOffsets
from splatreel.scene.camera import Camera

OUT_OF_STEP = 0.1
"""Smallest time offset in frames that is reported."""


@dataclass(frozen=True)
class Poses:
    """World-to-camera matrices [C, 4, 4] of a group, and the numbers `kept` [C] of its cameras, where some were left out."""

    viewmats: np.ndarray
    kept: np.ndarray | None = None


@dataclass(frozen=True)
class Rig:
    """The training cameras as they are known so far. A stage that learns more makes a new rig.

    Attributes:
        gains: Color gains [C, 3] float32 with a mean of 1.
        exposure: Logarithms [C, 3] float32 of the exposures at the keyframe, relative to the capture's first frame.
        light: Logarithm [3] of the light at the keyframe, relative to the capture's first frame.
        ends: Time offsets [C] at the end of each group so far.
    """

    cameras: list[Camera]
    gains: np.ndarray
    exposure: np.ndarray
    light: np.ndarray
    ends: tuple[np.ndarray, ...] = ()

    @staticmethod
    def of(cameras: list[Camera]) -> Rig:
        """Return a rig of cameras of which only the poses are known."""
        count = len(cameras)
        return Rig(
            list(cameras),
            np.ones((count, 3), np.float32),
            np.zeros((count, 3), np.float32),
            np.zeros(3, np.float32),
        )

    @property
    def names(self) -> list[str]:
        """Names of the cameras."""
        return [camera.name for camera in self.cameras]

    @property
    def time_offsets(self) -> np.ndarray:
        """Frames [C] float64 by which each camera is late."""
        return self.ends[-1] if self.ends else np.zeros(len(self.cameras))

    def with_poses(self, poses: Poses) -> Rig:
        """Return the rig at other poses, without cameras that were left out."""
        rig, kept = self, poses.kept
        if kept is not None and len(kept) < len(self.cameras):
            rig = Rig.of([self.cameras[number] for number in kept])
        pairs = zip(rig.cameras, poses.viewmats, strict=True)
        return replace(rig, cameras=[replace(camera, viewmat=viewmat) for camera, viewmat in pairs])

    def evened(self) -> Rig:
        """Return the rig with the exposures and the light of the capture's first frame."""
        return replace(self, exposure=np.zeros_like(self.exposure), light=np.zeros_like(self.light))

    def with_offsets(self, offsets: np.ndarray) -> Rig:
        """Return the rig with the time offsets [C] at the end of one more group."""
        return replace(self, ends=(*self.ends, offsets))


def check_first_poses(rig: Rig, frames: np.ndarray, origin: str, progress: Progress) -> Poses:
    """Check the poses at the start of a capture: correct wrong ones, and leave out cameras that show something else.

    `frames` [2, C, H, W, 3] are of two moments. `origin` names the file of the poses.

    Raises:
        ReconstructionError: The poses are not world to camera.
    """
    found = inspect_poses(rig.cameras, frames)
    _report_repairs(rig, found, progress)
    found.refuse(origin)
    for doubt in found.doubts(rig.names):
        progress.note(doubt)
    kept = [number for number in range(len(rig.cameras)) if number not in found.strangers]
    return Poses(_viewmats(rig, found)[kept], np.array(kept))


def check_later_poses(rig: Rig, frames: np.ndarray, progress: Progress) -> Poses:
    """Check the poses in a later group: correct those of cameras that were moved."""
    found = inspect_poses(rig.cameras, frames)
    _report_repairs(rig, found, progress)
    for number in found.strangers:
        progress.note(f"{rig.names[number]} no longer shows what its neighbors show: check its video")
    return Poses(_viewmats(rig, found))


def report_offsets(rig: Rig, learned: LearnedOffsets, progress: Progress) -> None:
    """Report the camera that is most out of step, if the images tell."""
    late, off = np.abs(learned.values), learned.uncertainty(list(rig.ends))
    told = late > np.maximum(CERTAIN * off, OUT_OF_STEP)
    if told.any():
        worst = int(np.where(told, late, 0).argmax())
        how = "late" if learned.values[worst] > 0 else "early"
        much = f"{late[worst]:.2f} frames {how} (uncertainty {off[worst]:.2f})"
        progress.note(f"cameras are out of step, {rig.names[worst]} is {much}: corrected")


def _report_repairs(rig: Rig, found: PoseFindings, progress: Progress) -> None:
    for repair in found.repairs(rig.names):
        progress.note(repair)


def _viewmats(rig: Rig, found: PoseFindings) -> np.ndarray:
    """Return world-to-camera matrices [C, 4, 4] of all cameras, corrected where they were wrong."""
    corrected = {number: corrected.camera for number, corrected in found.corrected.items()}
    return np.stack([corrected.get(number, camera).viewmat for number, camera in enumerate(rig.cameras)])
