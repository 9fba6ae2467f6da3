"""Rendering of Gaussians for playback on the CPU, with the kernels that training uses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from splatreel.kernels.image import render_image
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

Color = tuple[float, float, float]
Draw = Callable[[Gaussians, Camera, float, bool, Color], np.ndarray]
"""Function of (Gaussians, camera, near plane in world units, antialias, background) that returns an image.

The image is [H, W, 3] float32, whose values may exceed 1.
"""


def draw_on_cpu(gaussians: Gaussians, camera: Camera, near: float, antialias: bool, background: Color) -> np.ndarray:
    """Render on the CPU, see `Draw`."""
    return render_image(gaussians, camera, near=near, antialias=antialias, background=background)
