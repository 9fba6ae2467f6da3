"""Renders Gaussians to a numpy image on the CPU, without torch."""

from __future__ import annotations

import numpy as np

from splatreel.errors import GaussiansError
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
    """The view of a camera, [H, W, 3] float32; values may exceed 1. degree: SH degree used, by default all there is.

    antialias: see `splat.antialiased`; what was trained with it is drawn with it, which a reel's manifest says.

    Raises `GaussiansError` for NaN or infinity.
    """
    gaussians.check_finite()
    if degree is None:
        degree = gaussians.sh_degree
    if not 0 <= degree <= gaussians.sh_degree:
        raise GaussiansError(f"render_image: SH degree {degree} is not within 0..{gaussians.sh_degree}.")
    width, height = camera.width, camera.height
    view = project.Pinhole(camera.viewmat, camera.K, width, height, near, FINE_BLUR if antialias else BLUR)
    means2d, conics, depths, radii = project.forward(gaussians.means, gaussians.quats, gaussians.scales, view)
    colors = harmonics.forward(degree, gaussians.means - camera.center, gaussians.sh)
    colors = np.maximum(colors + np.float32(0.5), 0)
    opacities = gaussians.opacities
    if antialias:
        opacities = opacities * np.sqrt(np.maximum(project.kept_area(*conics.T), 0))
    bins = binning.bin_splats(means2d, conics, opacities, depths, radii, width, height)
    image, alpha = rasterize.forward(bins, colors)
    return image + (1 - alpha[..., None]) * np.asarray(background, np.float32)
