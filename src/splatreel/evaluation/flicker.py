"""Flicker: difference between the frame-to-frame changes of rendered and true images."""

from __future__ import annotations

import numpy as np

from splatreel.codec.manifest import Manifest


class Flicker:
    """Flicker of images added in order of frames.

    Attributes:
        borders: Frames that fade from one group to the next.
        steps: Flicker by frame and camera.
    """

    def __init__(self, borders: set[int]) -> None:
        self.borders = borders
        self.steps: dict[tuple[int, str], float] = {}
        self._last: dict[str, tuple[int, np.ndarray]] = {}

    def add(self, frame: int, camera: str, image: np.ndarray, truth: np.ndarray) -> None:
        """Add an image and its truth, float32 [H, W, 3] 0..1. Without the previous frame nothing is measured."""
        off = image - truth
        before, there = self._last.get(camera, (None, off))
        if before == frame - 1:
            self.steps[frame, camera] = 255 * float(np.abs(off - there).mean())
        self._last[camera] = frame, off

    def mean(self, at_borders: bool) -> float | None:
        """Return the mean absolute error of the changes in gray levels of 255, at borders or elsewhere; None without any."""
        values = [step for (frame, _), step in self.steps.items() if (frame in self.borders) == at_borders]
        return float(np.mean(values)) if values else None


def border_frames(manifest: Manifest) -> set[int]:
    """Return the frames reached by a step of a cross-fade, or by the cut between groups without overlap."""
    steps = range(1, manifest.overlap + 1) if manifest.overlap else range(1)
    return {group.first_frame + step for group in manifest.groups[1:] for step in steps}
