"""Rendering Gaussians to an image."""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.kernels import harmonics, splat
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians


def render_image(
    gaussians: Gaussians,
    camera: Camera,
    *,
    near: float = 0.01,
    degree: int | None = None,
    background: tuple[float, float, float] = (0, 0, 0),
    antialias: bool = False,
) -> np.ndarray:
    """Render the view of a camera.

    Args:
        gaussians: The Gaussians.
        camera: The camera, whose size is the size of the image.
        near: Smallest depth drawn, world units.
        degree: SH degree used. None: the degree of the Gaussians.
        background: RGB, 0..1, shown where alpha is below 1.
        antialias: See `splat.antialiased`. It must match the training; the manifest of a reel has the flag.

    Returns:
        The image [H, W, 3] float32. Values may exceed 1.

    Raises:
        GaussiansError: A value is NaN or infinite, or the Gaussians do not have the SH degree.
    """
    degree = gaussians.sh_degree if degree is None else degree
    if not 0 <= degree <= gaussians.sh_degree:
        raise GaussiansError(f"render_image: SH degree {degree} is not within 0..{gaussians.sh_degree}.")
    return _over(background, *splat.rasterize(_splats(gaussians, camera, near, degree, antialias), *_size(camera)))


class Backdrop:
    """The view of a camera of Gaussians that do not change, drawn once."""

    def __init__(
        self,
        gaussians: Gaussians,
        camera: Camera,
        *,
        near: float = 0.01,
        background: tuple[float, float, float] = (0, 0, 0),
        antialias: bool = False,
    ) -> None:
        self.camera = camera
        self.near = near
        self.background = background
        self.antialias = antialias
        self._frozen = splat.freeze(_splats(gaussians, camera, near, gaussians.sh_degree, antialias), *_size(camera))

    def with_others(self, gaussians: Gaussians) -> np.ndarray:
        """Return the image [H, W, 3] float32 of other Gaussians drawn among these, in the order of all their depths."""
        splats = _splats(gaussians, self.camera, self.near, gaussians.sh_degree, self.antialias)
        return _over(self.background, *splat.rasterize(splats, *_size(self.camera), self._frozen))


def _size(camera: Camera) -> tuple[int, int]:
    return camera.width, camera.height


def _splats(gaussians: Gaussians, camera: Camera, near: float, degree: int, antialias: bool) -> splat.Splats:
    """Return Gaussians projected to an image, with the colors that its camera sees."""
    gaussians.check_finite()
    shapes = gaussians.means, gaussians.quats, gaussians.scales
    projected = splat.project(*shapes, camera.viewmat, camera.K, *_size(camera), near, antialias)
    colors = harmonics.forward(degree, gaussians.means - camera.center, gaussians.sh)
    colors = np.maximum(colors + np.float32(0.5), 0)
    opacities = gaussians.opacities
    return projected.colored(colors, splat.antialiased(opacities, projected.conics) if antialias else opacities)


def _over(background: tuple[float, float, float], image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return image + (1 - alpha[..., None]) * np.asarray(background, np.float32)
