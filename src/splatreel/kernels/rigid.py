"""Rigid motion of patches of points, found by matching colors in all views. One task per patch.

A patch is a row of K point indices. Its move is a rotation and a translation, [3, 4]. The cost of a move is the mean color difference
between the points and the pixels that they move to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, types

from splatreel.base import threads
from splatreel.base.jit import B1, B2, F1, F2, F3, F4, FAST, FLOAT, L1, L2, L3, U4, range_kernel
from splatreel.kernels import sceneflow
from splatreel.kernels.scalars import HALF, ONE, ZERO, F, finite

STAY = np.eye(3, 4, dtype=np.float32)
"""The move that changes nothing."""
CHUNKS = 8
"""Ranges per thread. Patches differ in effort, and the difficult ones are neighbors."""
FITS = 256
"""Patches whose moves are fitted at a time."""
HIDDEN = F(sceneflow.HIDDEN)
PAIRS = 128
"""Maximum number of (point, view) pairs that the cost of a move is computed from."""
CAP = F(0.25)
"""Maximum color difference of a pair, 0..1. It limits the effect of views in which something occludes the patch."""
STEP, LEAN = F(0.5), F(0.15)
"""First steps of the search: translation as a share of the patch's size, and rotation in radians."""
ROUNDS, TRIES = 3, 2
"""Number of step sizes, each half of the one before, and maximum number of improvements with each."""


class Views(NamedTuple):
    """The images of all cameras at one frame. `make_views` makes them.

    viewmats: [C, 4, 4]. Ks: [C, 3, 3]. images: [C, H, W, 3] uint8. depths: [C, ceil(H / 2), ceil(W / 2)] float32, finite, the
    surfaces that may hide points. near: near plane.
    """

    viewmats: np.ndarray
    Ks: np.ndarray
    images: np.ndarray
    depths: np.ndarray
    near: np.float32


VIEWS = types.NamedTuple((F3, F3, U4, F3, FLOAT), Views)


class Template(NamedTuple):
    """Reference colors of points, and the views to find them in. seen: [N, C] bool and colors: [N, C, 3], see `sample_colors`."""

    seen: np.ndarray
    colors: np.ndarray
    views: Views


def make_views(viewmats: np.ndarray, Ks: np.ndarray, images: np.ndarray, depths: np.ndarray, near: float) -> Views:
    """Make `Views`. The depths may be infinite where nothing hides points."""
    return Views(viewmats, Ks, images, finite(depths), F(near))


def sample_colors(points: np.ndarray, views: Views) -> tuple[np.ndarray, np.ndarray]:
    """Return seen [N, C] bool, whether a view sees a point, and colors [N, C, 3] float32, 0..255, of points [N, 3] in every view.

    Where a view does not see a point, the color is the mean over the views that do.
    """
    shape = len(points), len(views.Ks)
    seen, colors = np.zeros(shape, np.bool_), np.zeros((*shape, 3), np.float32)
    _sample_colors.over(len(points), points, views, seen, colors)
    return seen, colors


def color_differences(places: np.ndarray, patches: np.ndarray, template: Template) -> np.ndarray:
    """Return the mean color difference [Q], 0..1, of patches [Q, K] of points at `places` [N, 3] from the template.

    It is 0 for patches that hardly any view sees.
    """
    out = np.empty(len(patches), np.float32)
    _color_differences.over(len(patches), places, patches, STAY, *template, _space_for_pairs(patches), out)
    return out


def initial_moves(
    here: np.ndarray, last: np.ndarray, there: np.ndarray, patches: np.ndarray, judged: np.ndarray, template: Template
) -> tuple[np.ndarray, np.ndarray]:
    """Return a first move [Q, 3, 4] for each patch [Q, K], and its cost [Q]; 0 for patches that were not judged.

    A patch of `judged` [Q] takes the cheapest of three moves: the fit to `there`, no motion, or its move from `last` to
    `here` once more. Other patches take the fit to `there`, the points one frame later according to optical flow.
    """
    moves, costs = np.empty((len(patches), 3, 4), np.float32), np.zeros(len(patches), np.float32)
    flow, again = rigid_fits(here, there, patches), np.empty_like(moves)
    again[judged] = rigid_fits(last, here, patches[judged])
    given = here, patches, judged, flow, STAY, again, *template, _space_for_pairs(patches)
    _initial_moves.over(len(patches), *given, moves, costs, chunks=_chunks())
    return moves, costs


def rigid_fits(start: np.ndarray, end: np.ndarray, patches: np.ndarray) -> np.ndarray:
    """Return the move [Q, 3, 4] float32 of each patch [Q, K] that fits its points in `start` to those in `end` (Kabsch 1976)."""
    moves = np.empty((len(patches), 3, 4), np.float32)

    def fit(first: int) -> None:
        moves[first : first + FITS] = _rigid_fits(start, end, patches[first : first + FITS])

    threads.map_parallel(fit, range(0, len(patches), FITS))
    return moves


def _rigid_fits(start: np.ndarray, end: np.ndarray, patches: np.ndarray) -> np.ndarray:
    a, b = (positions[patches].astype(np.float64) for positions in (start, end))
    center_a, center_b = a.mean(1, keepdims=True), b.mean(1, keepdims=True)
    U, _, Vt = np.linalg.svd((a - center_a).transpose(0, 2, 1) @ (b - center_b))
    U[:, :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[:, None]
    R = (U @ Vt).transpose(0, 2, 1)
    moves = np.empty((len(patches), 3, 4), np.float32)
    moves[:, :, :3] = R
    moves[:, :, 3] = center_b[:, 0] - (R @ center_a.transpose(0, 2, 1))[:, :, 0]
    return moves


def refine_moves(
    here: np.ndarray,
    patches: np.ndarray,
    chosen: np.ndarray,
    around: np.ndarray,
    moves: np.ndarray,
    costs: np.ndarray,
    share: float,
    template: Template,
) -> None:
    """Improve the moves of chosen patches [B] in one sweep, in place.

    Each patch tries the moves of its neighbors `around` [Q, A], then small changes of the best move. `share` is the
    size of the first steps, relative to the default.
    """
    given = here, patches, chosen, around, moves.copy(), F(share), *template
    space = _space_for_pairs(patches), np.empty((len(patches), 2, 3, 4), np.float32)
    _refine_moves.over(len(chosen), *given, *space, moves, costs, chunks=_chunks())


def _space_for_pairs(patches: np.ndarray) -> np.ndarray:
    return np.empty((len(patches), PAIRS, 2), np.int64)


def _chunks() -> int:
    return CHUNKS * threads.count()


@njit(inline="always")
def _pixel(x, y, z, views, c):
    """Return row and column of a point in a view. The row is -1 if the point is outside of the image or hidden."""
    V, K = views.viewmats[c], views.Ks[c]
    depth = V[2, 0] * x + V[2, 1] * y + V[2, 2] * z + V[2, 3]
    row = column = -1
    if depth > views.near:
        across = K[0, 0] * (V[0, 0] * x + V[0, 1] * y + V[0, 2] * z + V[0, 3]) / depth + K[0, 2]
        down = K[1, 1] * (V[1, 0] * x + V[1, 1] * y + V[1, 2] * z + V[1, 3]) / depth + K[1, 2]
        if ZERO <= across < views.images.shape[2] and ZERO <= down < views.images.shape[1]:
            row, column = int(down), int(across)
            if depth > HIDDEN * views.depths[c, row // 2, column // 2]:
                row = -1
    return row, column


@range_kernel(F2, VIEWS, B2, F3)
def _sample_colors(first, last, points, views, seen, colors):
    for i in range(first, last):
        red, green, blue, count = ZERO, ZERO, ZERO, ZERO
        for c in range(seen.shape[1]):
            row, column = _pixel(points[i, 0], points[i, 1], points[i, 2], views, c)
            if row >= 0:
                seen[i, c] = True
                count += ONE
                for k in range(3):
                    colors[i, c, k] = views.images[c, row, column, k]
                red += colors[i, c, 0]
                green += colors[i, c, 1]
                blue += colors[i, c, 2]
        count = max(count, ONE)
        for c in range(seen.shape[1]):
            if not seen[i, c]:
                colors[i, c, 0], colors[i, c, 1], colors[i, c, 2] = red / count, green / count, blue / count


@njit(**FAST)
def _pairs(patch, seen, pairs):
    """Fill [PAIRS, 2] with points of a patch and views that see them, an even choice, and return the length of the filled part."""
    total = 0
    for i in patch:
        for c in range(seen.shape[1]):
            total += seen[i, c]
    stride = (total + PAIRS - 1) // PAIRS
    rank, count = 0, 0
    for i in patch:
        for c in range(seen.shape[1]):
            if seen[i, c]:
                if rank % stride == 0:
                    pairs[count, 0], pairs[count, 1] = i, c
                    count += 1
                rank += 1
    return count


@njit(**FAST)
def _difference(places, move, pairs, colors, views, unseen=CAP, limit=CAP):
    """Return the mean color difference of the pairs after a move, or `unseen` if at most half of the pairs are still visible.

    The sum ends early, with some value that is not below `limit`, once the mean cannot be below `limit` anymore.
    """
    total, count, most = ZERO, 0, limit * F(pairs.shape[0])
    for p in range(pairs.shape[0]):
        if total > most:
            return CAP
        i, c = pairs[p, 0], pairs[p, 1]
        a, b, d = places[i, 0], places[i, 1], places[i, 2]
        x = move[0, 0] * a + move[0, 1] * b + move[0, 2] * d + move[0, 3]
        y = move[1, 0] * a + move[1, 1] * b + move[1, 2] * d + move[1, 3]
        z = move[2, 0] * a + move[2, 1] * b + move[2, 2] * d + move[2, 3]
        row, column = _pixel(x, y, z, views, c)
        if row >= 0:
            difference = ZERO
            for k in range(3):
                difference += abs(F(views.images[c, row, column, k]) - colors[i, c, k]) / F(3 * 255)
            total += min(difference, CAP)
            count += 1
    return total / F(count) if 2 * count > pairs.shape[0] else unseen


@range_kernel(F2, L2, F2, B2, F3, VIEWS, L3, F1)
def _color_differences(first, last, places, patches, stay, seen, colors, views, space, out):
    for t in range(first, last):
        pairs = space[t, : _pairs(patches[t], seen, space[t])]
        out[t] = _difference(places, stay, pairs, colors, views, ZERO)


@njit(**FAST)
def _copy(move, out):
    for j in range(3):
        for k in range(4):
            out[j, k] = move[j, k]


@range_kernel(F2, L2, B1, F3, F2, F3, B2, F3, VIEWS, L3, F3, F1)
def _initial_moves(begin, end, here, patches, judged, flow, stay, again, seen, colors, views, space, moves, costs):
    """Choose the cheapest of the moves of each judged patch; other patches take `flow`. flow, again: [Q, 3, 4]. stay: [3, 4]."""
    for t in range(begin, end):
        _copy(flow[t], moves[t])
        if judged[t]:
            pairs = space[t, : _pairs(patches[t], seen, space[t])]
            costs[t] = _difference(here, flow[t], pairs, colors, views)
            for move in (stay, again[t]):
                cost = _difference(here, move, pairs, colors, views)
                if cost < costs[t]:
                    costs[t] = cost
                    _copy(move, moves[t])


@njit(**FAST)
def _change(move, center, axis, amount, out):
    """Put into `out` a move followed by a translation along an axis (0..2), or a rotation about one (3..5) through the moved center."""
    _copy(move, out)
    if axis < 3:
        out[axis, 3] += amount
        return
    i, j = (axis - 2) % 3, (axis - 1) % 3
    c, s = np.cos(amount), np.sin(amount)
    x, y, z = center
    at_i = move[i, 0] * x + move[i, 1] * y + move[i, 2] * z + move[i, 3]
    at_j = move[j, 0] * x + move[j, 1] * y + move[j, 2] * z + move[j, 3]
    for k in range(4):
        a, b = move[i, k] - (at_i if k == 3 else ZERO), move[j, k] - (at_j if k == 3 else ZERO)
        out[i, k] = c * a - s * b + (at_i if k == 3 else ZERO)
        out[j, k] = s * a + c * b + (at_j if k == 3 else ZERO)


@njit(**FAST)
def _extent(places, patch):
    """Return the center of a patch, x, y and z, and the mean distance of its points from the center."""
    x, y, z, size, share = ZERO, ZERO, ZERO, ZERO, ONE / F(len(patch))
    for i in patch:
        x, y, z = x + places[i, 0] * share, y + places[i, 1] * share, z + places[i, 2] * share
    for i in patch:
        a, b, c = places[i, 0] - x, places[i, 1] - y, places[i, 2] - z
        size += np.sqrt(a * a + b * b + c * c) * share
    return (x, y, z), size


@range_kernel(F2, L2, L1, L2, F3, FLOAT, B2, F3, VIEWS, L3, F4, F3, F1)
def _refine_moves(
    first, last, here, patches, chosen, around, given, share, seen, colors, views, space, trials, moves, costs
):
    """Improve moves.

    given: a copy of the moves, which other patches' updates do not change. trials: [Q, 2, 3, 4], space for the start of a round and
    for a trial. Arrays that are made in the loop, and the references to them, would take half of the time.
    """
    for n in range(first, last):
        t = chosen[n]
        pairs = space[t, : _pairs(patches[t], seen, space[t])]
        best, cost, base, move = moves[t], costs[t], trials[t, 0], trials[t, 1]
        for other in around[t]:
            found = _difference(here, given[other], pairs, colors, views, CAP, cost)
            if found < cost:
                _copy(given[other], best)
                cost = found
        center, size = _extent(here, patches[t])
        shift, turn = share * STEP * size, share * LEAN
        for _ in range(ROUNDS):
            for _ in range(TRIES):
                _copy(best, base)
                before = cost
                for way in range(12):
                    sign, axis = F(1 - 2 * (way % 2)), way // 2
                    _change(base, center, axis, sign * (shift if axis < 3 else turn), move)
                    found = _difference(here, move, pairs, colors, views, CAP, cost)
                    if found < cost:
                        _copy(move, best)
                        cost = found
                if cost == before:
                    break
            shift, turn = HALF * shift, HALF * turn
        costs[t] = cost
