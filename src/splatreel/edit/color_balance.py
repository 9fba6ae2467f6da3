"""Brightness and color balance of a clip, as the light of its groups. No point is encoded again for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatreel.edit.changed_clip import ChangedClip
from splatreel.edit.clip import Clip, ClipGroup

GAMMA = 2.2
"""Exponent between light and colors. An exposure then multiplies colors, as the light of a group does."""


class Lit(ChangedClip):
    """Clip whose colors are multiplied by `gain` [3], also those of the background."""

    def __init__(self, clip: Clip, gain: np.ndarray) -> None:
        super().__init__(clip)
        self._gain = np.asarray(gain, np.float32)

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group in another light."""
        light = np.ones((found.group.frames, 3), np.float32) if found.group.light is None else found.group.light
        return replace(found, group=replace(found.group, light=light * self._gain))


def gain_of_exposure(stops: float) -> np.ndarray:
    """Return the gain [3] of an exposure longer by a number of stops."""
    return np.full(3, 2 ** (stops / GAMMA))


def gain_of_white(color: np.ndarray) -> np.ndarray:
    """Return the gain [3] that makes a color [3], 0..1, gray without a change of its mean brightness."""
    return color.mean() / color
