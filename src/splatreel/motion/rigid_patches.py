"""Rigid patches: neighboring points, each patch moved as a rigid body to where all views show its colors.

They track what is small, thin or fast, where optical flow fails: of a bat that swings by twice its width, a patch of pixels holds
mostly background. A patch of points knows how it moved before, what its neighbors found, and its colors in many views. Good moves
are handed on from patch to patch and refined by small steps, in turns, as PatchMatch (Barnes et al. 2009) does in images.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from splatreel.kernels import rigid
from splatreel.kernels.rigid import Template, Views

SIZE, STRIDE = 24, 3
"""Points of a patch, and from the center of one patch to the next."""
NEIGHBORS = (1, 2, 3, 4, 6, 8, 10, 12)
"""Ranks, by distance, of the neighbors whose moves a patch tries."""
BAD = 0.06
"""Color difference, 0..1, from which on flow is not believed."""
BETTER = 0.85
"""A rigid move must leave less than this share of that difference."""
RATE = 0.2
"""How fast colors follow what is seen where flow is believed: light changes, and what turns shows another side."""
STEPS = (1.0, 0.5, 0.25)
"""Steps of the search in each sweep, as a share of the first ones."""


class RigidPatches:
    """Patches of points [N, 3]. views: of a moment at which they are in place; their colors are taken there.

    `motion` then takes them from frame to frame, in either direction.
    """

    def __init__(self, points: np.ndarray, views: Views) -> None:
        self.colors = rigid.sample_colors(points, views)[1]
        self.trusted = np.zeros(len(points), np.bool_)  # flow has brought them here, and that looked right
        self.patches = np.zeros((0, SIZE), np.int64)
        if len(points) > SIZE:
            centers = points[::STRIDE]
            self.patches = _nearest(points, centers, range(SIZE))
            self.neighbors = _nearest(centers, centers, [rank for rank in NEIGHBORS if rank < len(centers)])

    def motion(self, here: np.ndarray, last: np.ndarray, flow: np.ndarray, now: Views, then: Views) -> np.ndarray:
        """How the points move, [N, 3]: as the flow says, or with a patch, where that fits the pictures clearly better.

        here: [N, 3] where they are; last: where they were; flow: [N, 3]. now, then: the views at both moments; now with the depths of
        all that is seen, then with those of what is known to be there.
        """
        if not len(self.patches):
            return flow
        seen, colors = rigid.sample_colors(here, now)
        learn = seen & self.trusted[:, None]
        self.colors[learn] += RATE * (colors[learn] - self.colors[learn])
        template = Template(seen, self.colors, then)
        costs = rigid.color_differences(here + flow, self.patches, template)
        bad = costs > BAD
        chosen = np.flatnonzero(bad)
        moves, found = rigid.initial_moves(here, last, here + flow, self.patches, bad, template)
        for share in STEPS:
            rigid.refine_moves(here, self.patches, chosen, self.neighbors, moves, found, share, template)
        least = np.full(len(here), np.inf, np.float32)
        np.minimum.at(least, self.patches.ravel(), np.repeat(costs, SIZE))
        self.trusted = least <= BAD
        return self._best(here, flow, least, np.flatnonzero(bad & (found < BETTER * costs)), moves, found)

    def _best(
        self,
        here: np.ndarray,
        flow: np.ndarray,
        least: np.ndarray,
        better: np.ndarray,
        moves: np.ndarray,
        found: np.ndarray,
    ) -> np.ndarray:
        """The motion [N, 3] of every point: that of the best of its patches.

        least: [N] the smallest difference that flow leaves of a patch of each, changed in place. better: the patches that do not
        move as it says.
        """
        motion = flow.copy()
        for patch in better:
            points = self.patches[patch][found[patch] < least[self.patches[patch]]]
            motion[points] = here[points] @ moves[patch, :, :3].T + moves[patch, :, 3] - here[points]
            least[points] = found[patch]
        return motion


def _nearest(points: np.ndarray, queries: np.ndarray, ranks: Sequence[int]) -> np.ndarray:
    """[Q, R] int64 of the points nearest to each query, those of some ranks from 0 on."""
    wanted: Any = [rank + 1 for rank in ranks]
    return np.asarray(KDTree(points).query(queries, k=wanted)[1], np.int64)
