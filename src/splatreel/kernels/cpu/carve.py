"""Space carving: masks that contain a sample point, and color differences of their views. One task per ray."""

from __future__ import annotations

from splatreel.base.jit import B3, F2, F3, FLOAT, U4, range_kernel
from splatreel.kernels.cpu.scalars import ONE, ZERO, F

HIDDEN = F(1.05)
"""A point is hidden from a view if its depth is larger than this many times the known depth at its pixel."""


@range_kernel(F3, F2, F3, F3, U4, B3, F3, FLOAT, FLOAT, FLOAT, F2)
def disagreement(first, last, places, own, viewmats, Ks, images, wrong, depths, near, least, share, out):
    """Kernel of `splatreel.kernels.carve.disagreement`."""
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
