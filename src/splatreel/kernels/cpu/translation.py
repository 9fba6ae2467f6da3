"""Color differences between two frames under candidate translations of points. One task per translation."""

from __future__ import annotations

from splatreel.base.jit import F1, F2, F3, FLOAT, U4, range_kernel
from splatreel.kernels.cpu.carve import HIDDEN
from splatreel.kernels.cpu.scalars import ONE, ZERO, F


@range_kernel(F2, F2, F3, F3, U4, U4, F3, FLOAT, F1)
def color_differences(first, last, points, motions, viewmats, Ks, here, there, depths, near, out):
    """Kernel of `splatreel.kernels.translation.color_differences`."""
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
