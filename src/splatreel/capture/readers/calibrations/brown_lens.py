"""Lens of Brown's model with four radial coefficients and skew, which COLMAP's models lack."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np


@dataclass
class BrownLens:
    """Lens with the interface of a pycolmap.Camera that `undistorted_camera` uses.

    Attributes:
        width: Width of the image in pixels.
        height: Height of the image in pixels.
        pinhole: fx, fy, cx, cy in pixels.
        radial: k1, k2, k3, k4, of the second to the eighth power of the radius.
        tangential: p1, p2 in OpenCV's order.
        skew: Element K[0, 1] in pixels.
    """

    width: int
    height: int
    pinhole: tuple[float, ...]
    radial: tuple[float, ...]
    tangential: tuple[float, ...]
    skew: float

    @property
    def model(self) -> SimpleNamespace:
        """Model with its name."""
        return SimpleNamespace(name="BROWN")

    @property
    def params(self) -> list[float]:
        """All parameters, for messages."""
        return [*self.pinhole, *self.radial, *self.tangential, self.skew]

    def mean_focal_length(self) -> float:
        """Return the mean of both focal lengths."""
        return (self.pinhole[0] + self.pinhole[1]) / 2

    def img_from_cam(self, rays: np.ndarray) -> np.ndarray:
        """Project points [N, 3] in front of the camera to pixels, [N, 2]."""
        x, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
        square = x * x + y * y
        k1, k2, k3, k4 = self.radial
        p1, p2 = self.tangential
        stretch = 1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))
        bent_x = x * stretch + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        bent_y = y * stretch + p1 * (square + 2 * y * y) + 2 * p2 * x * y
        fx, fy, cx, cy = self.pinhole
        return np.stack([fx * bent_x + self.skew * bent_y + cx, fy * bent_y + cy], 1)
