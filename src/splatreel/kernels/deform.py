"""Deformation, shading, projection and colors of points for one frame and view, in one pass, and the gradient.

As separate operations these would take two dozen calls and passes over memory: half of the time of a group's training iteration outside
of blending.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, types

from splatreel.base.jit import BOOL, F1, F2, F3, I1, range_kernel
from splatreel.kernels.harmonics import color_one, color_one_backward
from splatreel.kernels.motion import product, unit_gradient
from splatreel.kernels.project import (
    CONIC,
    FINE_BLUR,
    GRAIN,
    LANES,
    LIMITS,
    MEAN,
    POINT_FLOATS,
    QUAT,
    SCALE,
    SPLAT_FLOATS,
    Pinhole,
    load_rows,
    load_splats,
    project_block,
    project_block_backward,
    store_rows,
    store_splats,
    unit_quaternion,
)
from splatreel.kernels.rows import choose, stack_floats
from splatreel.kernels.scalars import HALF, ONE, TWO, ZERO, F

FINE = F(FINE_BLUR)
QUAT_FLOATS = 4 * LANES
LEAST_AREA = F(1e-6)

Arrays = tuple[np.ndarray, ...]


class DeformedPoints(NamedTuple):
    """Unconstrained canonical points and their offsets at one time.

    means [N, 3], quats [N, 4], log_scales [N, 3], logit_opacities [N], base [N, 1, 3], rest [N, K - 1, 3], dx [N, 3], dq [N, 4],
    shade [N, 4]. An offset without rows means no change.
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
    """Results that `backward` needs.

    The first five are the splats: means2d [N, 2], conics [N, 3], colors [N, 3], depths [N] and radii [N]. means, quats and scales are
    those of the deformed points. opaque: [N], their opacities before antialiasing.
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
    """Return the opacities [N] of the splats, and all other results. A view with a blur of FINE_BLUR is antialiased."""
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
    """Return the gradients to the fields of `moment`, without dx. The gradient to dx equals that to the means."""
    d_moment = _like(*moment[:6], moment.dq, moment.shade)
    d_seen = d_means2d, d_conics, d_colors, d_opacities
    inputs = tuple(moment), tuple(seen), view.blur == FINE_BLUR, view.viewmat, view.lens, center
    _deform_backward.over(len(moment.means), *inputs, d_seen, d_moment, grain=GRAIN)
    return d_moment


def _like(*arrays: np.ndarray) -> Arrays:
    return tuple(np.empty_like(array) for array in arrays)


@njit(inline="always")
def _kept_area(a, b, c):
    """Return `project.kept_area`, at least LEAST_AREA."""
    return max(ONE - FINE * (a + c) + FINE * FINE * (a * c - b * b), LEAST_AREA)


@njit(inline="always")
def _turn_block(quats, dq, out, row):
    """Write the Hamilton products quats * dq / |dq| of a block into four rows of `out`."""
    for lane in range(LANES):
        w, x, y, z, _ = unit_quaternion(dq, 0, lane)
        a, b, c, d = quats[lane], quats[LANES + lane], quats[2 * LANES + lane], quats[3 * LANES + lane]
        a, b, c, d = product(a, b, c, d, w, x, y, z)
        out[row * LANES + lane], out[(row + 1) * LANES + lane] = a, b
        out[(row + 2) * LANES + lane], out[(row + 3) * LANES + lane] = c, d


@njit(inline="always")
def _turn_block_backward(quats, dq, d_products, row, d_quats, d_dq):
    """Compute the gradients of `_turn_block` from rows `row` to `row + 4` of the block d_products.

    The gradient to one factor is the gradient to the product times the conjugate of the other factor, on the same side.
    """
    for lane in range(LANES):
        w, x, y, z, inverse = unit_quaternion(dq, 0, lane)
        gw, gx = d_products[row * LANES + lane], d_products[(row + 1) * LANES + lane]
        gy, gz = d_products[(row + 2) * LANES + lane], d_products[(row + 3) * LANES + lane]
        a, b, c, d = product(gw, gx, gy, gz, w, -x, -y, -z)
        d_quats[lane], d_quats[LANES + lane], d_quats[2 * LANES + lane], d_quats[3 * LANES + lane] = a, b, c, d
        a, b, c, d = quats[lane], -quats[LANES + lane], -quats[2 * LANES + lane], -quats[3 * LANES + lane]
        a, b, c, d = product(a, b, c, d, gw, gx, gy, gz)
        a, b, c, d = unit_gradient(w, x, y, z, inverse, a, b, c, d)
        d_dq[lane], d_dq[LANES + lane], d_dq[2 * LANES + lane], d_dq[3 * LANES + lane] = a, b, c, d


MOMENT = types.Tuple((F2, F2, F2, F1, F3, F3, F2, F2, F2))
SEEN = types.Tuple((F2, F2, F2, F1, I1, F2, F2, F2, F1))


@range_kernel(MOMENT, SEEN, BOOL, F2, F1, LIMITS, F1, F1)
def _deform(first, last, moment, seen, antialias, V, lens, limits, center, opacities):
    canonical, turns, _, _, base, rest, dx, dq, shade = moment
    means2d, conics, colors, depths, radii, means, quats, scales, opaque = seen
    moved, shaded = dx.shape[0] > 0, shade.shape[0] > 0
    points, splats = stack_floats(POINT_FLOATS), stack_floats(SPLAT_FLOATS)
    before, turn, basis = stack_floats(QUAT_FLOATS), stack_floats(QUAT_FLOATS), stack_floats(16)
    for start in range(first, last, LANES):
        count = min(LANES, last - start)
        for i in range(start, start + count):
            for c in range(3):
                means[i, c] = canonical[i, c] + (dx[i, c] if moved else ZERO)
        load_rows(means, start, count, 3, points, MEAN)
        load_rows(scales, start, count, 3, points, SCALE)
        if moved:
            load_rows(turns, start, count, 4, before, 0)
            load_rows(dq, start, count, 4, turn, 0)
            _turn_block(before, turn, points, QUAT)
        else:
            load_rows(turns, start, count, 4, points, QUAT)
        project_block(points, V, lens, limits, splats)
        store_rows(points, QUAT, start, count, 4, quats)
        store_splats(splats, start, count, means2d, conics, depths, radii)
        for i in range(start, start + count):
            red, green, blue = base[i, 0, 0], base[i, 0, 1], base[i, 0, 2]
            if shaded:
                red, green, blue = red + shade[i, 0], green + shade[i, 1], blue + shade[i, 2]
            color_one(i, means, center, red, green, blue, rest, basis, colors)
            kept = _kept_area(conics[i, 0], conics[i, 1], conics[i, 2]) if antialias else ONE
            opacities[i] = opaque[i] * math.sqrt(kept)


D_SEEN = types.Tuple((F2, F2, F2, F1))
D_MOMENT = types.Tuple((F2, F2, F2, F1, F3, F3, F2, F2))


@njit(inline="always")
def _antialias_block_backward(splats, d_splats, opaque, d_opaque):
    """Add the part through the antialiased opacities to the gradients of the conics, and scale d_opaque by the kept area's root."""
    for lane in range(LANES):
        a, b = splats[CONIC * LANES + lane], splats[(CONIC + 1) * LANES + lane]
        c = splats[(CONIC + 2) * LANES + lane]
        area = _kept_area(a, b, c)
        root = math.sqrt(area)
        slope = choose(area > LEAST_AREA, d_opaque[lane] * opaque[lane] * HALF / root, ZERO)
        d_splats[CONIC * LANES + lane] += slope * FINE * (FINE * c - ONE)
        d_splats[(CONIC + 1) * LANES + lane] -= slope * FINE * FINE * TWO * b
        d_splats[(CONIC + 2) * LANES + lane] += slope * FINE * (FINE * a - ONE)
        d_opaque[lane] *= root


@range_kernel(MOMENT, SEEN, BOOL, F2, F1, F1, D_SEEN, D_MOMENT)
def _deform_backward(first, last, moment, seen, antialias, V, lens, center, d_seen, d_moment):
    _, turns, _, _, _, _, _, dq, shade = moment
    _, conics, colors, _, radii, means, quats, scales, opaque = seen
    d_means2d, d_conics, d_colors, d_opacities = d_seen
    d_means, d_quats, d_log_scales, d_logits, d_base, d_rest, d_dq, d_shade = d_moment
    moved, shaded = dq.shape[0] > 0, shade.shape[0] > 0
    points, splats, d_points = stack_floats(POINT_FLOATS), stack_floats(SPLAT_FLOATS), stack_floats(POINT_FLOATS)
    d_splats, before, turn = stack_floats(SPLAT_FLOATS), stack_floats(QUAT_FLOATS), stack_floats(QUAT_FLOATS)
    d_before, d_turn, basis = stack_floats(QUAT_FLOATS), stack_floats(QUAT_FLOATS), stack_floats(16)
    opacity, d_opacity = stack_floats(LANES), stack_floats(LANES)
    for start in range(first, last, LANES):
        count = min(LANES, last - start)
        load_rows(means, start, count, 3, points, MEAN)
        load_rows(quats, start, count, 4, points, QUAT)
        load_rows(scales, start, count, 3, points, SCALE)
        load_splats(conics, d_means2d, d_conics, radii, start, count, splats, d_splats)
        for lane in range(LANES):
            i = start + min(lane, count - 1)
            opacity[lane], d_opacity[lane] = opaque[i], d_opacities[i]
        if antialias:
            _antialias_block_backward(splats, d_splats, opacity, d_opacity)
        project_block_backward(points, splats, d_splats, V, lens, d_points)
        store_rows(d_points, MEAN, start, count, 3, d_means)
        if moved:
            load_rows(turns, start, count, 4, before, 0)
            load_rows(dq, start, count, 4, turn, 0)
            _turn_block_backward(before, turn, d_points, QUAT, d_before, d_turn)
            store_rows(d_before, 0, start, count, 4, d_quats)
            store_rows(d_turn, 0, start, count, 4, d_dq)
        else:
            store_rows(d_points, QUAT, start, count, 4, d_quats)
        for lane in range(count):
            i = start + lane
            color_one_backward(i, means, center, colors, d_colors, basis, d_base, d_rest)
            d_logits[i] = d_opacity[lane] * opacity[lane] * (ONE - opacity[lane])
            for c in range(3):
                d_log_scales[i, c] = d_points[(SCALE + c) * LANES + lane] * scales[i, c]
                if shaded:
                    d_shade[i, c] = d_base[i, 0, c]
            if shaded:
                d_shade[i, 3] = d_logits[i]
