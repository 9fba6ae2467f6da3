"""What a run knows of its cameras, and hands from group to group: poses, color gains, exposures and the light, time offsets."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splatreel.progress import Progress
from splatreel.recon.cameras.findings import Findings
from splatreel.recon.cameras.poses import check_poses
from splatreel.recon.cameras.time_offsets import CERTAIN, LearnedOffsets
from splatreel.scene.camera import Camera

OUT_OF_STEP = 0.1
"""Frames that a camera is late, from which on a user hears of it, if the pictures tell so much."""


@dataclass(frozen=True)
class Poses:
    """Where cameras stand in a group. viewmats: [C, 4, 4]. kept: [C] their numbers among those before, where some were left out."""

    viewmats: np.ndarray
    kept: np.ndarray | None = None


@dataclass(frozen=True)
class Rig:
    """The training cameras as a group finds them. A stage that learns more of them gives another rig.

    cameras: C, as they stand. gains: [C, 3] float32, mean 1, of their colors. exposure: [C, 3] float32, logarithms of theirs at the
    keyframe, against the capture's first. light: [3] that of the light. ends: [C] time offsets at the end of each group so far.
    """

    cameras: list[Camera]
    gains: np.ndarray
    exposure: np.ndarray
    light: np.ndarray
    ends: tuple[np.ndarray, ...] = ()

    @staticmethod
    def of(cameras: list[Camera]) -> Rig:
        """Nothing is known yet."""
        count = len(cameras)
        return Rig(
            list(cameras),
            np.ones((count, 3), np.float32),
            np.zeros((count, 3), np.float32),
            np.zeros(3, np.float32),
        )

    @property
    def names(self) -> list[str]:
        return [camera.name for camera in self.cameras]

    @property
    def time_offsets(self) -> np.ndarray:
        """[C] float64, frames by which each camera is late."""
        return self.ends[-1] if self.ends else np.zeros(len(self.cameras))

    def with_poses(self, poses: Poses) -> Rig:
        """The cameras where they stand, without those that were left out."""
        rig, kept = self, poses.kept
        if kept is not None and len(kept) < len(self.cameras):
            rig = Rig.of([self.cameras[number] for number in kept])
        pairs = zip(rig.cameras, poses.viewmats, strict=True)
        return replace(rig, cameras=[replace(camera, viewmat=viewmat) for camera, viewmat in pairs])

    def evened(self) -> Rig:
        """With the exposures and the light of the capture's first frame."""
        return replace(self, exposure=np.zeros_like(self.exposure), light=np.zeros_like(self.light))

    def with_offsets(self, offsets: np.ndarray) -> Rig:
        """With the time offsets [C] at the end of one more group."""
        return replace(self, ends=(*self.ends, offsets))


def check_first_poses(rig: Rig, frames: np.ndarray, origin: str, progress: Progress) -> Poses:
    """At the start of a capture: cameras that are not where they are said to be are put right, strangers left out.

    frames: [2, C, H, W, 3] uint8, two moments of the first group. origin: where the poses come from, for messages. Raises
    `ReconstructionError` for poses that are not world to camera.
    """
    found = check_poses(rig.cameras, frames)
    _report_repairs(rig, found, progress)
    found.refuse(origin)
    for doubt in found.doubts(rig.names):
        progress.note(doubt)
    kept = [number for number in range(len(rig.cameras)) if number not in found.strangers]
    return Poses(_viewmats(rig, found)[kept], np.array(kept))


def check_later_poses(rig: Rig, frames: np.ndarray, progress: Progress) -> Poses:
    """In a later group: cameras that were touched are put right. frames: [2, C, H, W, 3] uint8, two moments of it."""
    found = check_poses(rig.cameras, frames)
    _report_repairs(rig, found, progress)
    for number in found.strangers:
        progress.note(f"{rig.names[number]} no longer shows what its neighbors do: check its video")
    return Poses(_viewmats(rig, found))


def report_offsets(rig: Rig, learned: LearnedOffsets, progress: Progress) -> None:
    """Say which camera is out of step, if the pictures tell. rig: with the offsets that were learned."""
    late, off = np.abs(learned.values), learned.uncertainty(list(rig.ends))
    told = late > np.maximum(CERTAIN * off, OUT_OF_STEP)
    if told.any():
        worst = int(np.where(told, late, 0).argmax())
        how = "late" if learned.values[worst] > 0 else "early"
        much = f"{late[worst]:.2f} frames {how} (give or take {off[worst]:.2f})"
        progress.note(f"cameras are out of step, {rig.names[worst]} is {much}: allowed for")


def _report_repairs(rig: Rig, found: Findings, progress: Progress) -> None:
    for repair in found.repairs(rig.names):
        progress.note(repair)


def _viewmats(rig: Rig, found: Findings) -> np.ndarray:
    """[C, 4, 4] of all cameras, those of the findings put right."""
    mended = {number: mended.camera for number, mended in found.mended.items()}
    return np.stack([mended.get(number, camera).viewmat for number, camera in enumerate(rig.cameras)])
