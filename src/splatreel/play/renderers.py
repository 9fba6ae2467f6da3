"""Rendering of Gaussians for playback, on the CPU or a CUDA device, with the kernels that training uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from splatreel.base.errors import UsageError
from splatreel.kernels.image import render_image
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

Color = tuple[float, float, float]
Draw = Callable[[Gaussians, Camera, float, bool, Color], np.ndarray]
"""Function of (Gaussians, camera, near plane in world units, antialias, background) that returns an image.

The image is [H, W, 3] float32, whose values may exceed 1.
"""


def renderer(name: Literal["cpu", "cuda"]) -> Draw:
    """Return the draw function of a device. Raises `UsageError` if there is no CUDA device. Only CUDA imports torch."""
    return _cuda() if name == "cuda" else draw_on_cpu


def draw_on_cpu(gaussians: Gaussians, camera: Camera, near: float, antialias: bool, background: Color) -> np.ndarray:
    """Render on the CPU, see `Draw`."""
    return render_image(gaussians, camera, near=near, antialias=antialias, background=background)


def _cuda() -> Draw:
    import torch

    from splatreel.kernels import splat

    if not torch.cuda.is_available():
        raise UsageError("There is no CUDA device for --renderer cuda. Choose --renderer cpu or webgl.")

    def draw(gaussians: Gaussians, camera: Camera, near: float, antialias: bool, background: Color) -> np.ndarray:
        g, view = gaussians, (camera.viewmat, camera.K, camera.width, camera.height)
        arrays = (g.means, g.quats, g.scales, g.opacities, g.sh)
        means, quats, scales, opacities, sh = (torch.from_numpy(array).cuda() for array in arrays)
        with torch.no_grad():
            drawn = splat.render(means, quats, scales, opacities, sh, *view, near=near, antialias=antialias)
            behind = (1 - drawn.alpha[..., None]) * torch.tensor(background, device="cuda")
        return (drawn.image + behind).cpu().numpy()

    return draw
