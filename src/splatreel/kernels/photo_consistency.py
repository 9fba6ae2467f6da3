"""Photo-consistency: color differences of views at points along rays (a task a ray) and under candidate translations (a task each)."""

from __future__ import annotations

import numpy as np

from splatreel.base.jit import B3, F1, F2, F3, FLOAT, U4, range_kernel
from splatreel.kernels.scalars import ONE, ZERO, F, finite

HIDDEN = F(1.05)
"""A point is hidden from a view if its depth is larger than this many times the known depth at its pixel."""


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
    """Return the mean color difference [R, D], 0..1, between D sample points along R rays and the colors [R, 3] of the rays.

    It is the mean over the views whose masks `wrong` [C, H, W] contain the point; infinite for points that fewer than
    `least` masks contain, or a smaller share than `share` of the masks of the views that see them. A view sees a point
    if it projects into the image and no known surface (`depths` [C, H, W]) hides it.
    """
    out = np.full(places.shape[:2], np.inf, np.float32)
    places, own, viewmats, Ks = (np.ascontiguousarray(array, np.float32) for array in (places, own, viewmats, Ks))
    limits = F(near), F(least), F(share)
    _disagreement.over(len(out), places, own, viewmats, Ks, images, wrong, finite(depths), *limits, out, grain=16)
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
    """Return the mean color difference [M], 0..1, between points [P, 3] and where each candidate translation [M, 3] moves them all.

    It is the mean over the views that see a point in both frames; 1 where no view does. `depths` [C, H, W] may hide
    points in the first frame.
    """
    points, motions, viewmats, Ks = (
        np.ascontiguousarray(array, np.float32) for array in (points, motions, viewmats, Ks)
    )
    out = np.ones(len(motions), np.float32)
    inputs = points, motions, viewmats, Ks, here, there, finite(depths), F(near)
    _color_differences.over(len(motions), *inputs, out)
    return out


@range_kernel(F3, F2, F3, F3, U4, B3, F3, FLOAT, FLOAT, FLOAT, F2)
def _disagreement(first, last, places, own, viewmats, Ks, images, wrong, depths, near, least, share, out):
    height, width = wrong.shape[1:]
    for ray in range(first, last):
        for d in range(places.shape[1]):
            x, y, z = places[ray, d, 0], places[ray, d, 1], places[ray, d, 2]
            inside = agree = difference = ZERO
            for c in range(viewmats.shape[0]):
                V, K = viewmats[c], Ks[c]
                depth = V[2, 0] * x + V[2, 1] * y + V[2, 2] * z + V[2, 3]
                if depth <= near:
                    continue
                across = K[0, 0] * (V[0, 0] * x + V[0, 1] * y + V[0, 2] * z + V[0, 3]) / depth + K[0, 2]
                down = K[1, 1] * (V[1, 0] * x + V[1, 1] * y + V[1, 2] * z + V[1, 3]) / depth + K[1, 2]
                if not (-ONE < across < width and -ONE < down < height):
                    continue
                column, row = int(across), int(down)
                if depth > HIDDEN * depths[c, row, column]:
                    continue
                inside += ONE
                if wrong[c, row, column]:
                    agree += ONE
                    for k in range(3):
                        difference += abs(F(images[c, row, column, k]) / F(255) - own[ray, k]) / F(3)
            if agree >= least and agree >= share * inside:
                out[ray, d] = difference / agree


@range_kernel(F2, F2, F3, F3, U4, U4, F3, FLOAT, F1)
def _color_differences(first, last, points, motions, viewmats, Ks, here, there, depths, near, out):
    height, width = depths.shape[1:]
    for m in range(first, last):
        count = difference = ZERO
        for p in range(points.shape[0]):
            for c in range(viewmats.shape[0]):
                V, K = viewmats[c], Ks[c]
                x, y, z = points[p, 0], points[p, 1], points[p, 2]
                row = column = 0
                for moment in range(2):
                    depth = V[2, 0] * x + V[2, 1] * y + V[2, 2] * z + V[2, 3]
                    if depth <= near:
                        break
                    across = K[0, 0] * (V[0, 0] * x + V[0, 1] * y + V[0, 2] * z + V[0, 3]) / depth + K[0, 2]
                    down = K[1, 1] * (V[1, 0] * x + V[1, 1] * y + V[1, 2] * z + V[1, 3]) / depth + K[1, 2]
                    if not (ZERO <= across < width and ZERO <= down < height):
                        break
                    if moment == 0:
                        row, column = int(down), int(across)
                        if depth > HIDDEN * depths[c, row, column]:
                            break
                        x, y, z = x + motions[m, 0], y + motions[m, 1], z + motions[m, 2]
                    else:
                        count += ONE
                        for k in range(3):
                            a, b = F(here[c, row, column, k]), F(there[c, int(down), int(across), k])
                            difference += abs(a - b) / F(3 * 255)
        if count > ZERO:
            out[m] = difference / count
