"""Points of one moment as a view sees them: deformed, shaded, projected and colored in one pass, and the gradient of it all.

One by one these are two dozen passes over memory, and as many calls: half of what an iteration of a group spends outside of blending.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, types

from splatreel.jit import BOOL, F1, F2, F3, I1, range_kernel
from splatreel.kernels.cpu.harmonics import color_one, color_one_backward
from splatreel.kernels.cpu.motion import turn_one, turn_one_backward
from splatreel.kernels.cpu.project import FINE_BLUR, GRAIN, LIMITS, Pinhole, project_one, project_one_backward
from splatreel.kernels.cpu.rows import stack_floats
from splatreel.kernels.cpu.scalars import HALF, ONE, TWO, ZERO, F

FINE = F(FINE_BLUR)
LEAST_AREA = F(1e-6)

Arrays = tuple[np.ndarray, ...]


class DeformedPoints(NamedTuple):
    """Canonical points, unconstrained, and what changes them: means [N, 3], quats [N, 4], log_scales [N, 3], logit_opacities [N],
    base [N, 1, 3], rest [N, K - 1, 3], dx [N, 3], dq [N, 4], shade [N, 4]; the last three may have no rows, for none.
    """

    means: np.ndarray
    quats: np.ndarray
    log_scales: np.ndarray
    logit_opacities: np.ndarray
    base: np.ndarray
    rest: np.ndarray
    dx: np.ndarray
    dq: np.ndarray
    shade: np.ndarray


class ProjectedPoints(NamedTuple):
    """What `backward` needs again. The first five are the splats: means2d [N, 2], conics [N, 3], colors [N, 3], depths and radii [N].

    means, quats, scales: of the deformed points; opaque: [N] their opacities, before what antialiasing takes.
    """

    means2d: np.ndarray
    conics: np.ndarray
    colors: np.ndarray
    depths: np.ndarray
    radii: np.ndarray
    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opaque: np.ndarray


def forward(moment: DeformedPoints, center: np.ndarray, view: Pinhole) -> tuple[np.ndarray, ProjectedPoints]:
    """The splats' opacities [N], and the rest. A view with a blur of FINE_BLUR is antialiased."""
    n, shade = len(moment.means), moment.shade
    logits = moment.logit_opacities + shade[:, 3] if len(shade) else moment.logit_opacities
    means2d, conics, colors = (np.empty((n, size), np.float32) for size in (2, 3, 3))
    depths, radii, opacities = np.empty(n, np.float32), np.empty(n, np.int32), np.empty(n, np.float32)
    means, quats = np.empty_like(moment.means), np.empty_like(moment.quats)
    opaque = 1 / (1 + np.exp(np.minimum(-logits, F(80))))
    seen = ProjectedPoints(means2d, conics, colors, depths, radii, means, quats, np.exp(moment.log_scales), opaque)
    pinhole = view.viewmat, view.lens, view.limits, center
    _deform.over(n, tuple(moment), tuple(seen), view.blur == FINE_BLUR, *pinhole, opacities, grain=GRAIN)
    return opacities, seen


def backward(
    moment: DeformedPoints,
    seen: ProjectedPoints,
    center: np.ndarray,
    view: Pinhole,
    d_means2d: np.ndarray,
    d_conics: np.ndarray,
    d_colors: np.ndarray,
    d_opacities: np.ndarray,
) -> Arrays:
    """Gradients to the fields of the moment, dx apart, whose gradient is that of the means."""
    d_moment = _like(*moment[:6], moment.dq, moment.shade)
    room = _like(d_conics, moment.quats)
    d_seen = d_means2d, d_conics, d_colors, d_opacities
    inputs = tuple(moment), tuple(seen), view.blur == FINE_BLUR, view.viewmat, view.lens, center
    _deform_backward.over(len(moment.means), *inputs, d_seen, room, d_moment, grain=GRAIN)
    return d_moment


def _like(*arrays: np.ndarray) -> Arrays:
    return tuple(np.empty_like(array) for array in arrays)


@njit(inline="always")
def _kept_area(conics, i):
    """As `project.kept_area`, at least LEAST_AREA."""
    a, b, c = conics[i, 0], conics[i, 1], conics[i, 2]
    return max(ONE - FINE * (a + c) + FINE * FINE * (a * c - b * b), LEAST_AREA)


MOMENT = types.Tuple((F2, F2, F2, F1, F3, F3, F2, F2, F2))
SEEN = types.Tuple((F2, F2, F2, F1, I1, F2, F2, F2, F1))


@range_kernel(MOMENT, SEEN, BOOL, F2, F1, LIMITS, F1, F1)
def _deform(first, last, moment, seen, antialias, V, lens, limits, center, opacities):
    canonical, turns, _, _, base, rest, dx, dq, shade = moment
    means2d, conics, colors, depths, radii, means, quats, scales, opaque = seen
    moved, shaded = dx.shape[0] > 0, shade.shape[0] > 0
    for i in range(first, last):
        basis = stack_floats(16)
        for c in range(3):
            means[i, c] = canonical[i, c] + (dx[i, c] if moved else ZERO)
        red, green, blue = base[i, 0, 0], base[i, 0, 1], base[i, 0, 2]
        if shaded:
            red, green, blue = red + shade[i, 0], green + shade[i, 1], blue + shade[i, 2]
        if moved:
            turn_one(i, turns, dq, quats)
        else:
            for c in range(4):
                quats[i, c] = turns[i, c]
        project_one(i, means, quats, scales, V, lens, limits, means2d, conics, depths, radii)
        color_one(i, means, center, red, green, blue, rest, basis, colors)
        opacities[i] = opaque[i] * (math.sqrt(_kept_area(conics, i)) if antialias else ONE)


D_SEEN = types.Tuple((F2, F2, F2, F1))
ROOM = types.UniTuple(F2, 2)
D_MOMENT = types.Tuple((F2, F2, F2, F1, F3, F3, F2, F2))


@range_kernel(MOMENT, SEEN, BOOL, F2, F1, F1, D_SEEN, ROOM, D_MOMENT)
def _deform_backward(first, last, moment, seen, antialias, V, lens, center, d_seen, room, d_moment):
    _, turns, _, _, _, _, _, dq, shade = moment
    _, conics, colors, _, radii, means, quats, scales, opaque = seen
    d_means2d, d_conics, d_colors, d_opacities = d_seen
    d_blurred, d_product = room
    d_means, d_quats, d_log_scales, d_logits, d_base, d_rest, d_dq, d_shade = d_moment
    moved, shaded = dq.shape[0] > 0, shade.shape[0] > 0
    for i in range(first, last):
        basis, d_opaque = stack_floats(16), d_opacities[i]
        for c in range(3):
            d_blurred[i, c] = d_conics[i, c]
        if antialias:
            area = _kept_area(conics, i)
            root = math.sqrt(area)
            slope = d_opaque * opaque[i] * HALF / root if area > LEAST_AREA else ZERO
            d_blurred[i, 0] += slope * FINE * (FINE * conics[i, 2] - ONE)
            d_blurred[i, 1] -= slope * FINE * FINE * TWO * conics[i, 1]
            d_blurred[i, 2] += slope * FINE * (FINE * conics[i, 0] - ONE)
            d_opaque *= root
        project_one_backward(
            i,
            means,
            quats,
            scales,
            V,
            lens,
            conics,
            radii,
            d_means2d,
            d_blurred,
            ZERO,
            d_means,
            d_product,
            d_log_scales,
        )
        if moved:
            turn_one_backward(i, turns, dq, d_product, d_quats, d_dq)
        else:
            for c in range(4):
                d_quats[i, c] = d_product[i, c]
        color_one_backward(i, means, center, colors, d_colors, basis, d_base, d_rest)
        d_logits[i] = d_opaque * opaque[i] * (ONE - opaque[i])
        for c in range(3):
            d_log_scales[i, c] *= scales[i, c]
            if shaded:
                d_shade[i, c] = d_base[i, 0, c]
        if shaded:
            d_shade[i, 3] = d_logits[i]
