"""Rigid patches: groups of neighboring points, moved as a rigid body to where all views show their colors.

They track small, thin or fast content, for which optical flow fails. Around a bat that swings by twice its width, a patch of
pixels contains mostly background. A patch of points knows its earlier motion, the motion of its neighbors, and its colors in
many views. As in PatchMatch, good motions are passed on between patches and refined by small steps, in turns.

Source:
    Barnes et al. 2009.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from splatreel.kernels import rigid
from splatreel.kernels.rigid import Template, Views

PATCH_POINTS, PATCH_STRIDE = 24, 3
"""Number of points of a patch, and points between the centers of two patches."""
NEIGHBORS = (1, 2, 3, 4, 6, 8, 10, 12)
"""Ranks, by distance, of the neighbors whose motions a patch tries."""
MAX_FLOW_DIFFERENCE = 0.06
"""Color difference, 0..1, above which flow is considered wrong."""
MAX_RESIDUAL = 0.85
"""A rigid motion must leave less than this share of that difference."""
COLOR_RATE = 0.2
"""Rate at which stored colors follow the observed ones where flow is right, since light changes and objects turn."""
STEPS = (1.0, 0.5, 0.25)
"""Step sizes of the search in each sweep, relative to the first ones."""


class RigidPatches:
    """Patches of points."""

    def __init__(self, points: np.ndarray, views: Views) -> None:
        """Form patches and sample their colors.

        Args:
            points: [N, 3] positions.
            views: Views of a moment at which the points have these positions.
        """
        self.colors = rigid.sample_colors(points, views)[1]
        self.trusted = np.zeros(len(points), np.bool_)  # the flow of the last step matched the colors
        self.patches = np.zeros((0, PATCH_POINTS), np.int64)
        if len(points) > PATCH_POINTS:
            centers = points[::PATCH_STRIDE]
            self.patches = _nearest(points, centers, range(PATCH_POINTS))
            self.neighbors = _nearest(centers, centers, [rank for rank in NEIGHBORS if rank < len(centers)])

    def motion(self, here: np.ndarray, last: np.ndarray, flow: np.ndarray, now: Views, then: Views) -> np.ndarray:
        """Return the motion [N, 3] of the points: the flow, or a rigid motion of a patch where that fits the images clearly better.

        Args:
            here: [N, 3] positions now.
            last: [N, 3] positions at the previous frame.
            flow: [N, 3] motion by optical flow.
            now: Views at this frame, with depths of everything visible.
            then: Views at the next frame, with depths of the points known to be there.
        """
        if not len(self.patches):
            return flow
        seen, colors = rigid.sample_colors(here, now)
        learn = seen & self.trusted[:, None]
        self.colors[learn] += COLOR_RATE * (colors[learn] - self.colors[learn])
        template = Template(seen, self.colors, then)
        costs = rigid.color_differences(here + flow, self.patches, template)
        bad = costs > MAX_FLOW_DIFFERENCE
        chosen = np.flatnonzero(bad)
        moves, found = rigid.initial_moves(here, last, here + flow, self.patches, bad, template)
        for share in STEPS:
            rigid.refine_moves(here, self.patches, chosen, self.neighbors, moves, found, share, template)
        least = np.full(len(here), np.inf, np.float32)
        np.minimum.at(least, self.patches.ravel(), np.repeat(costs, PATCH_POINTS))
        self.trusted = least <= MAX_FLOW_DIFFERENCE
        return self._best(here, flow, least, np.flatnonzero(bad & (found < MAX_RESIDUAL * costs)), moves, found)

    def _best(
        self,
        here: np.ndarray,
        flow: np.ndarray,
        least: np.ndarray,
        better: np.ndarray,
        moves: np.ndarray,
        found: np.ndarray,
    ) -> np.ndarray:
        """Return the motion [N, 3] of the best patch of every point.

        Args:
            here: [N, 3] positions now.
            flow: [N, 3] motion by optical flow.
            least: [N] smallest color difference of a patch of each point under flow. Changed in place.
            better: Patches whose rigid motion is better than flow.
            moves: Rigid motions of the patches.
            found: Color differences of the rigid motions.
        """
        motion = flow.copy()
        for patch in better:
            points = self.patches[patch][found[patch] < least[self.patches[patch]]]
            motion[points] = here[points] @ moves[patch, :, :3].T + moves[patch, :, 3] - here[points]
            least[points] = found[patch]
        return motion


def _nearest(points: np.ndarray, queries: np.ndarray, ranks: Sequence[int]) -> np.ndarray:
    """Return [Q, R] int64, the points of certain ranks by distance from each query, ranks from 0."""
    wanted: Any = [rank + 1 for rank in ranks]
    return np.asarray(KDTree(points).query(queries, k=wanted)[1], np.int64)
