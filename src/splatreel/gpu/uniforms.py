"""Layout of the uniform block of a draw. `shaders/common.wgsl` declares the same fields in the same order."""

from __future__ import annotations

import numpy as np

VECTORS = ("row0", "row1", "row2", "lens", "bounds", "center", "background", "loss", "surfaces", "motion")
SHADES = ("shade_rates", "shade_price")
NUMBERS = ("size", "counts", "rows", "numbers", "links")

MOMENTS = 8
"""Moments of a draw: the drawn one, three for smoothness, two for the slope of the time, one unused, the appearance."""
DRAWN, START, END, BETWEEN, BEFORE, AFTER, _, APPEARANCE = range(MOMENTS)

MOVED, SHADED, METERED, METERED_STATIC, WHOLE, FINE, ABSOLUTE, LEARNS_GAINS, SCALED_STEPS, RIGID = (
    1 << bit for bit in range(10)
)
"""Flags of a draw."""

DRAW = np.dtype(
    [(name, np.float32, 4) for name in (*VECTORS, *SHADES)]
    + [(name, np.uint32, 4) for name in NUMBERS]
    + [("meters", np.float32, 4)]
    + [("knots", np.uint32, (MOMENTS, 4)), ("weights", np.float32, (MOMENTS, 4)), ("adam", np.float32, (10, 4))]
)


def new_draw() -> np.ndarray:
    """Return a block [] of zeros."""
    return np.zeros((), DRAW)


def fill_view(
    draw: np.ndarray, viewmat: np.ndarray, K: np.ndarray, width: int, height: int, near: float, antialias: bool
) -> None:
    """Fill the fields of a pinhole camera.

    Args:
        draw: Block to fill.
        viewmat: [4, 4] world to camera.
        K: [3, 3] pixels.
        width: Pixels.
        height: Pixels.
        near: Smallest depth drawn, world units.
        antialias: Blur splats by 0.1 square pixels instead of 0.3, and reduce their opacity accordingly.

    Source:
        `kernels.project.Pinhole`.
    """
    fx, fy, cx, cy = (float(K[index]) for index in ((0, 0), (1, 1), (0, 2), (1, 2)))
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    draw["row0"], draw["row1"], draw["row2"] = viewmat[:3]
    draw["lens"] = fx, fy, cx, cy
    draw["bounds"][:2] = -cx / fx - margin_x, (width - cx) / fx + margin_x
    draw["bounds"][2:] = -cy / fy - margin_y, (height - cy) / fy + margin_y
    draw["center"][:3] = -viewmat[:3, :3].T @ viewmat[:3, 3]
    draw["center"][3] = near
    draw["background"][3] = 0.1 if antialias else 0.3
    draw["size"] = width, height, -(-width // 16), -(-height // 16)
    draw["numbers"][0] = int(draw["numbers"][0]) & ~FINE | (FINE if antialias else 0)
