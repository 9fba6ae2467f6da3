"""Color gains of the cameras, learned with the scene, with a mean of one."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from splatreel.kernels import adam
from splatreel.method.deform.knot_adam import Adam, Restore


class CameraGains:
    """One gain for each camera and color channel, learned if `enabled`.

    The mean over the cameras stays one, so that a camera that was never seen needs none. Real cameras differ by several
    percent. Without gains the scene averages them, and every view is wrong.
    """

    def __init__(self, cameras: int, enabled: bool = True, rate: float = 2e-3) -> None:
        self.enabled = enabled
        self.adam = Adam(np.ones((cameras, 3), np.float32), rate, eps=1e-8)

    @property
    def values(self) -> np.ndarray:
        """Gains [cameras, 3] that a rendered image is multiplied by to match a camera's colors."""
        return self.adam.parameter

    def restart(self) -> None:
        """Forget the optimizer's momentum, as a run that is continued from a checkpoint does."""
        self.adam = Adam(self.values, self.adam.rate, self.adam.eps)

    def follow(self, known: Iterable[tuple[int, np.ndarray]]) -> None:
        """Make one optimizer step. known: cameras, and the gradients [3] to their gains."""
        gradient = np.zeros_like(self.values)
        for camera, slope in known:
            gradient[camera] += slope
        adam.adam([self.adam.follow(gradient)])
        self.values[:] /= self.values.mean(0)

    def snapshot(self) -> Restore:
        """Return a function that restores the gains and their optimizer."""
        return self.adam.snapshot()

    def load(self, values: np.ndarray) -> None:
        """Set the gains [cameras, 3]."""
        self.values[:] = values
