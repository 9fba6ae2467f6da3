"""Flicker: how far a picture's changes from frame to frame are from the truth's."""

from __future__ import annotations

import numpy as np

from splatreel.codec.manifest import Manifest


class Flicker:
    """Collects the pictures of frames in order. borders: frames whose picture fades from one group to the next."""

    def __init__(self, borders: set[int]) -> None:
        self.borders = borders
        self.steps: dict[tuple[int, str], float] = {}
        self._last: dict[str, tuple[int, np.ndarray]] = {}

    def add(self, frame: int, camera: str, image: np.ndarray, truth: np.ndarray) -> None:
        """A picture and its truth, float32 [H, W, 3] 0..1. Where the frame before is missing, no step is measured."""
        off = image - truth
        before, there = self._last.get(camera, (None, off))
        if before == frame - 1:
            self.steps[frame, camera] = 255 * float(np.abs(off - there).mean())
        self._last[camera] = frame, off

    def mean(self, at_borders: bool) -> float | None:
        """Mean absolute error of the steps in gray levels of 255, at borders or elsewhere; None if there are none."""
        values = [step for (frame, _), step in self.steps.items() if (frame in self.borders) == at_borders]
        return float(np.mean(values)) if values else None


def border_frames(manifest: Manifest) -> set[int]:
    """The frames of a reel that are reached by a step of a cross-fade, or by the cut where groups do not overlap."""
    steps = range(1, manifest.overlap + 1) if manifest.overlap else range(1)
    return {group.first_frame + step for group in manifest.groups[1:] for step in steps}
