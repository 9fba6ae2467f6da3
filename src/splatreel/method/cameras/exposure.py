"""Exposures of the cameras and light of the scene during a group, relative to the first frame of the capture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splatreel.base.progress import Progress
from splatreel.method.cameras.rig import Rig
from splatreel.method.images.exposure_changes import even_out, exposures

CHANGED = 0.02
"""Smallest change of an exposure or of the light that is reported, as a share."""


@dataclass(frozen=True)
class Exposure:
    """Exposures and light at every frame of a group.

    Attributes:
        change: Logarithms [T, C, 3] float32 of the factor of each camera.
        light: Logarithms [T, 3] float32 of the factor that all cameras have in common.
    """

    change: np.ndarray
    light: np.ndarray

    @property
    def light_factors(self) -> np.ndarray | None:
        """Factors [T, 3] float32, as in `Group.light`; None where the light does not change."""
        return np.exp(self.light) if self.light.any() else None


def measure_exposure(rig: Rig, frames: np.ndarray, reference: np.ndarray | None = None) -> Exposure:
    """Return the exposures and the light of a group.

    Args:
        rig: Cameras, with their exposures at the keyframe or at `reference`.
        frames: Images [T, C, H, W, 3] uint8 of the group, the keyframe first.
        reference: Images [C, H, W, 3] uint8 that the frames are compared with; by default the keyframe.
    """
    change, light = exposures(frames, reference)
    return Exposure(change + rig.exposure, light + rig.light)


def report_exposure(rig: Rig, found: Exposure, progress: Progress) -> None:
    """Report visible changes of exposures and light."""
    most = np.abs(found.change).max((0, 2))
    if most.max() > CHANGED:
        name = rig.names[int(most.argmax())]
        progress.note(f"exposures change by up to {most.max():.0%} ({name}): removed from the images")
    if (most := np.abs(np.expm1(found.light)).max()) > CHANGED:
        progress.note(
            f"the light changes by up to {most:.0%}: removed from the images, restored when the reel is played"
        )


def remove_exposure(frames: np.ndarray, exposure: Exposure) -> None:
    """Give images [T, C, H, W, 3] uint8 the exposure and the light of the capture's first frame, in place.

    A copy of a group would take much memory.
    """
    even_out(frames, exposure.change + exposure.light[:, None])


def at_next_keyframe(rig: Rig, exposure: Exposure, own: int) -> Rig:
    """Return the rig with its exposures at the next keyframe. `own` is the number of the group's frames without the overlap."""
    keyframe = min(own, len(exposure.change) - 1)  # without an overlap, the last frame is the nearest
    return replace(rig, exposure=exposure.change[keyframe], light=exposure.light[keyframe])
