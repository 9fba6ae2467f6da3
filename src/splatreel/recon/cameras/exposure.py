"""What cameras' exposures and the light did during a group, against the first frame of the capture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splatreel.motion.exposure import even_out, exposures
from splatreel.progress import Progress
from splatreel.recon.cameras.rig import Rig

CHANGED = 0.02
"""Share by which an exposure or the light changes, from which on a user hears of it."""


@dataclass(frozen=True)
class Exposure:
    """change: [T, C, 3], of each camera. light: [T, 3], what all have in common. Logarithms of factors, float32."""

    change: np.ndarray
    light: np.ndarray

    @property
    def light_factors(self) -> np.ndarray | None:
        """[T, 3] float32, as in `Group.light`; None where the light stays."""
        return np.exp(self.light) if self.light.any() else None


def measure_exposure(rig: Rig, frames: np.ndarray, reference: np.ndarray | None = None) -> Exposure:
    """From frames [T, C, H, W, 3] uint8 of a group, the keyframe first. rig: as it is at the keyframe, or at the reference.

    reference: [C, H, W, 3] uint8, what frames are compared with; by default the keyframe.
    """
    change, light = exposures(frames, reference)
    return Exposure(change + rig.exposure, light + rig.light)


def report_exposure(rig: Rig, found: Exposure, progress: Progress) -> None:
    """Say how much changes, if one would see it."""
    most = np.abs(found.change).max((0, 2))
    if most.max() > CHANGED:
        name = rig.names[int(most.argmax())]
        progress.note(f"exposures change by up to {most.max():.0%} ({name}): taken out of the pictures")
    if (most := np.abs(np.expm1(found.light)).max()) > CHANGED:
        progress.note(
            f"the light changes by up to {most:.0%}: taken out of the pictures, and back when they are played"
        )


def take_out(frames: np.ndarray, exposure: Exposure) -> None:
    """Give frames the exposure and the light of the capture's first frame, in place: a copy of a group takes much memory."""
    even_out(frames, exposure.change + exposure.light[:, None])


def at_next_keyframe(rig: Rig, exposure: Exposure, own: int) -> Rig:
    """The rig as the next group finds it. own: frames of the group that are not the next one's, too."""
    keyframe = min(own, len(exposure.change) - 1)  # the next one, if the groups overlap
    return replace(rig, exposure=exposure.change[keyframe], light=exposure.light[keyframe])
