"""Space carving: color differences between views at sample points along rays. A numba kernel on the CPU."""

from __future__ import annotations

import numpy as np

from splatreel.kernels.cpu import carve as kernel
from splatreel.kernels.cpu.scalars import F, finite


def disagreement(
    places: np.ndarray,
    own: np.ndarray,
    viewmats: np.ndarray,
    Ks: np.ndarray,
    images: np.ndarray,
    wrong: np.ndarray,
    depths: np.ndarray,
    near: float,
    least: float,
    share: float,
) -> np.ndarray:
    """Return the mean color difference between each sample point and its ray, over the views whose masks contain the point.

    A view sees a point if the point projects into its image and no known surface hides it.

    Args:
        places: [R, D, 3] world, D sample points along each of R rays.
        own: [R, 3], 0..1, the color of each ray.
        viewmats: [C, 4, 4] world to camera.
        Ks: [C, 3, 3] pixels.
        images: [C, H, W, 3] uint8.
        wrong: [C, H, W] bool, the mask of each view.
        depths: [C, H, W] depths of known surfaces; infinite where none is known.
        near: Smallest depth that a view sees, world units.
        least: Smallest number of masks that must contain a point.
        share: Smallest share, 0..1, of the views which see a point whose masks must contain it.

    Returns:
        [R, D] float32, 0..1; infinite for points that too few masks contain.
    """
    out = np.full(places.shape[:2], np.inf, np.float32)
    places, own, viewmats, Ks = (np.ascontiguousarray(array, np.float32) for array in (places, own, viewmats, Ks))
    limits = F(near), F(least), F(share)
    kernel.disagreement.over(len(out), places, own, viewmats, Ks, images, wrong, finite(depths), *limits, out, grain=16)
    return out
