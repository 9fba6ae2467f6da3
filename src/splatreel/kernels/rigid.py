"""Patches of points that move as rigid bodies: the rotation and shift after which all views show the same. Numba on the CPU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splatreel.kernels.cpu import rigid as kernel
from splatreel.kernels.cpu.rigid import Views
from splatreel.kernels.cpu.scalars import F, finite


class Template(NamedTuple):
    """What points are matched by: seen [N, C] bool and colors [N, C, 3], of `sample_colors`, and the views that are searched."""

    seen: np.ndarray
    colors: np.ndarray
    views: Views


def make_views(viewmats: np.ndarray, Ks: np.ndarray, pictures: np.ndarray, depths: np.ndarray, near: float) -> Views:
    """`Views` of depths that may be infinite: where nothing hides points."""
    return Views(viewmats, Ks, pictures, finite(depths), F(near))


def sample_colors(points: np.ndarray, views: Views) -> tuple[np.ndarray, np.ndarray]:
    """Which views see points [N, 3] float32, [N, C] bool, and in which colors, [N, C, 3] float32 of 0..255.

    Where a view does not see a point, its color is the mean of those that do.
    """
    shape = len(points), len(views.Ks)
    seen, colors = np.zeros(shape, np.bool_), np.zeros((*shape, 3), np.float32)
    kernel.sample_colors.over(len(points), points, views, seen, colors)
    return seen, colors


def color_differences(places: np.ndarray, patches: np.ndarray, template: Template) -> np.ndarray:
    """[Q] mean color difference, 0..1, of patches [Q, K] of points at places [N, 3]; 0 for those that hardly any view sees there."""
    out = np.empty(len(patches), np.float32)
    kernel.color_differences.over(len(patches), places, patches, *template, out)
    return out


def initial_moves(
    here: np.ndarray, last: np.ndarray, there: np.ndarray, patches: np.ndarray, judged: np.ndarray, template: Template
) -> tuple[np.ndarray, np.ndarray]:
    """[Q, 3, 4] how each patch moves from here to there, all [N, 3], and the difference [Q] of those that are judged [Q] bool.

    last: [N, 3] where the points were before. A judged patch moves in the best of three ways: not at all, as it did, or to there.
    """
    moves, costs = np.empty((len(patches), 3, 4), np.float32), np.zeros(len(patches), np.float32)
    kernel.initial_moves.over(len(patches), here, last, there, patches, judged, *template, moves, costs)
    return moves, costs


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
    """One sweep over the chosen patches: tries the moves of the patches around each [Q, A], then small changes of the best.

    chosen: [B] int64. moves, costs: as `initial_moves` returns them, changed in place. share: of the first steps.
    """
    given = here, patches, chosen, around, moves.copy(), F(share)
    kernel.refine_moves.over(len(chosen), *given, *template, moves, costs)
