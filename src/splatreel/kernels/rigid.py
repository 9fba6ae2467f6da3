"""Rigid motion of patches of points, found by matching colors in all views. Numba kernels on the CPU.

A patch is a row of K point indices. Its move is a rotation and a translation, [3, 4]. The cost of a move is the mean color difference
between the points and the pixels that they move to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splatreel.base import threads
from splatreel.kernels.cpu import rigid as kernel
from splatreel.kernels.cpu.rigid import Views
from splatreel.kernels.cpu.scalars import F, finite

STAY = np.eye(3, 4, dtype=np.float32)
"""The move that changes nothing."""
CHUNKS = 8
"""Ranges per thread. Patches differ in effort, and the difficult ones are neighbors."""


class Template(NamedTuple):
    """Reference colors of points, and the views to find them in. seen: [N, C] bool and colors: [N, C, 3], see `sample_colors`."""

    seen: np.ndarray
    colors: np.ndarray
    views: Views


def make_views(viewmats: np.ndarray, Ks: np.ndarray, images: np.ndarray, depths: np.ndarray, near: float) -> Views:
    """Make `Views`. The depths may be infinite where nothing hides points."""
    return Views(viewmats, Ks, images, finite(depths), F(near))


def sample_colors(points: np.ndarray, views: Views) -> tuple[np.ndarray, np.ndarray]:
    """Sample the colors of points in every view.

    Args:
        points: [N, 3] float32 world.
        views: The views.

    Returns:
        seen [N, C] bool, whether a view sees a point, and colors [N, C, 3] float32, 0..255. Where a view does not see a point, the
        color is the mean over the views that do.
    """
    shape = len(points), len(views.Ks)
    seen, colors = np.zeros(shape, np.bool_), np.zeros((*shape, 3), np.float32)
    kernel.sample_colors.over(len(points), points, views, seen, colors)
    return seen, colors


def color_differences(places: np.ndarray, patches: np.ndarray, template: Template) -> np.ndarray:
    """Return the mean color difference of patches between given positions and the template.

    Args:
        places: [N, 3] float32 world, the positions of the points.
        patches: [Q, K] int64, the points of each patch.
        template: Reference colors and the views to compare with.

    Returns:
        [Q] float32, 0..1; 0 for patches that hardly any view sees.
    """
    out = np.empty(len(patches), np.float32)
    kernel.color_differences.over(len(patches), places, patches, STAY, *template, _space_for_pairs(patches), out)
    return out


def initial_moves(
    here: np.ndarray, last: np.ndarray, there: np.ndarray, patches: np.ndarray, judged: np.ndarray, template: Template
) -> tuple[np.ndarray, np.ndarray]:
    """Return a first move for each patch.

    A judged patch takes the cheapest of three moves: the fit to `there`, no motion, or its move from `last` to `here` once more.
    Other patches take the fit to `there`.

    Args:
        here: [N, 3] float32 world, the points now.
        last: [N, 3], the points one frame before.
        there: [N, 3], the points one frame later according to optical flow.
        patches: [Q, K] int64, the points of each patch.
        judged: [Q] bool, the patches to compare moves for.
        template: Reference colors and the views of the later frame.

    Returns:
        The moves [Q, 3, 4] float32 and their costs [Q] float32; 0 for patches that were not judged.
    """
    moves, costs = np.empty((len(patches), 3, 4), np.float32), np.zeros(len(patches), np.float32)
    flow, again = rigid_fits(here, there, patches), np.empty_like(moves)
    again[judged] = rigid_fits(last, here, patches[judged])
    given = here, patches, judged, flow, STAY, again, *template, _space_for_pairs(patches)
    kernel.initial_moves.over(len(patches), *given, moves, costs, chunks=_chunks())
    return moves, costs


def rigid_fits(start: np.ndarray, end: np.ndarray, patches: np.ndarray) -> np.ndarray:
    """Return the move [Q, 3, 4] float32 of each patch that fits its points in `start` to those in `end` by least squares.

    Args:
        start: [N, 3] positions.
        end: [N, 3] positions after the move.
        patches: [Q, K] int64, the points of each patch.

    Source:
        Kabsch 1976.
    """
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
    """Improve the moves of chosen patches in one sweep, in place.

    Each patch tries the moves of its neighbors, then small changes of the best move.

    Args:
        here: [N, 3] float32 world, the points now.
        patches: [Q, K] int64, the points of each patch.
        chosen: [B] int64, the patches to improve.
        around: [Q, A] int64, the neighbors of each patch.
        moves: [Q, 3, 4], as `initial_moves` returns them.
        costs: [Q], as `initial_moves` returns them.
        share: Size of the first steps, relative to the default.
        template: Reference colors and the views of the later frame.
    """
    given = here, patches, chosen, around, moves.copy(), F(share), *template
    space = _space_for_pairs(patches), np.empty((len(patches), 2, 3, 4), np.float32)
    kernel.refine_moves.over(len(chosen), *given, *space, moves, costs, chunks=_chunks())


def _space_for_pairs(patches: np.ndarray) -> np.ndarray:
    return np.empty((len(patches), kernel.PAIRS, 2), np.int64)


def _chunks() -> int:
    return CHUNKS * threads.count()
