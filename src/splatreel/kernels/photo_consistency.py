"""Photo-consistency: color differences of views at points along rays, and under candidate translations. Numba kernels on the CPU."""

from __future__ import annotations

import numpy as np

from splatreel.kernels.cpu import photo_consistency as kernel
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


def color_differences(
    points: np.ndarray,
    motions: np.ndarray,
    viewmats: np.ndarray,
    Ks: np.ndarray,
    here: np.ndarray,
    there: np.ndarray,
    depths: np.ndarray,
    near: float,
) -> np.ndarray:
    """Return the mean color difference between points and the positions that each candidate translation moves them to.

    Args:
        points: [P, 3] world.
        motions: [M, 3] world, the candidate translations. All points take the same one.
        viewmats: [C, 4, 4] world to camera.
        Ks: [C, 3, 3] pixels.
        here: [C, H, W, 3] uint8, images of the first frame.
        there: [C, H, W, 3] uint8, images of the second frame.
        depths: [C, H, W], depths that may hide points in the first frame; infinite where nothing does.
        near: Smallest depth that a view sees, world units.

    Returns:
        [M] float32, 0..1, the mean over the views that see a point in both frames; 1 where no view does.
    """
    points, motions, viewmats, Ks = (
        np.ascontiguousarray(array, np.float32) for array in (points, motions, viewmats, Ks)
    )
    out = np.ones(len(motions), np.float32)
    inputs = points, motions, viewmats, Ks, here, there, finite(depths), F(near)
    kernel.color_differences.over(len(motions), *inputs, out)
    return out
