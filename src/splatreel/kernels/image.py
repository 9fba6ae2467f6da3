"""Rendering Gaussians to a numpy image on the CPU, without torch."""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.kernels.cpu import binning, harmonics, project, rasterize
from splatreel.kernels.cpu.project import BLUR, FINE_BLUR
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
    return _over(background, *rasterize.forward(*_binned(gaussians, camera, near, degree, antialias)))


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
        """Draw the Gaussians. Arguments and errors are those of `render_image`."""
        self.camera = camera
        self.near = near
        self.background = background
        self.antialias = antialias
        bins, colors = _binned(gaussians, camera, near, gaussians.sh_degree, antialias)
        self._frozen = rasterize.Frozen(bins, colors, *rasterize.forward(bins, colors))

    def with_others(self, gaussians: Gaussians) -> np.ndarray:
        """Return the image [H, W, 3] float32 of other Gaussians drawn among these, in the order of all their depths."""
        bins, colors = _binned(gaussians, self.camera, self.near, gaussians.sh_degree, self.antialias)
        return _over(self.background, *rasterize.forward(bins, colors, self._frozen))


def _binned(
    gaussians: Gaussians, camera: Camera, near: float, degree: int, antialias: bool
) -> tuple[binning.Bins, np.ndarray]:
    """Return Gaussians sorted into the tiles of an image, and their colors."""
    gaussians.check_finite()
    width, height = camera.width, camera.height
    view = project.Pinhole(camera.viewmat, camera.K, width, height, near, FINE_BLUR if antialias else BLUR)
    means2d, conics, depths, radii = project.forward(gaussians.means, gaussians.quats, gaussians.scales, view)
    colors = harmonics.forward(degree, gaussians.means - camera.center, gaussians.sh)
    colors = np.maximum(colors + np.float32(0.5), 0)
    opacities = gaussians.opacities
    if antialias:
        opacities = opacities * np.sqrt(np.maximum(project.kept_area(*conics.T), 0))
    return binning.bin_splats(means2d, conics, opacities, depths, radii, width, height), colors


def _over(background: tuple[float, float, float], image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return image + (1 - alpha[..., None]) * np.asarray(background, np.float32)
