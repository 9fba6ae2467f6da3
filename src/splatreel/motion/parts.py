"""What is small, thin or fast: patches of neighbouring points, each moved as a rigid body to where all views show its colours.

Flow knows nothing of a bat that swings by twice its width: its patches of pixels hold more of what is behind. A patch of points knows
how it moved before, what its neighbours found, and its colours in many views. Good moves are handed on from patch to patch and made
better by small steps, in turns, as PatchMatch (Barnes et al. 2009) does with patches of pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from splatreel.kernels.cpu import rigid
from splatreel.kernels.cpu.rigid import Eyes, Known

SIZE, EVERY = 24, 3
"""Points of a patch, and between the middles of two."""
AROUND = (1, 2, 3, 4, 6, 8, 10, 12)
"""Ranks of the neighbours that a patch asks."""
BAD = 0.06
"""Colour difference, 0..1, from which on flow is not believed."""
BETTER = 0.85
"""Of that difference, what a rigid move must be below."""
RATE = 0.2
"""How fast colours follow what is seen where flow is believed: light changes, and what turns."""
SHARES = (1.0, 0.5, 0.25)
"""Of the first steps of the search, one a sweep."""


class Parts:
    """Patches of points [N, 3] that are in place before `eyes`, whose depths say what they see: there their colours are learned.

    They are then taken from frame to frame by `motion`, in either direction.
    """

    def __init__(self, points: np.ndarray, eyes: Eyes) -> None:
        self.colors = rigid.look(points, eyes)[1]
        self.trusted = np.zeros(len(points), np.bool_)  # flow has brought them here, and that looked right
        self.patches = np.zeros((0, SIZE), np.int64)
        if len(points) > SIZE:
            middles = points[::EVERY]
            self.patches = _nearest(points, middles, range(SIZE))
            self.around = _nearest(middles, middles, [rank for rank in AROUND if rank < len(middles)])

    def motion(self, here: np.ndarray, last: np.ndarray, flow: np.ndarray, now: Eyes, then: Eyes) -> np.ndarray:
        """How the points move, [N, 3]: as the flow says, or with a patch, where that fits the pictures clearly better.

        here: [N, 3] where they are; last: where they were; flow: [N, 3]. now, then: the views at both moments; now with the depths of
        all that is seen, then with those of what is known to be there.
        """
        if not len(self.patches):
            return flow
        seen, colors = rigid.look(here, now)
        learn = seen & self.trusted[:, None]
        self.colors[learn] += RATE * (colors[learn] - self.colors[learn])
        known = Known(seen, self.colors, then)
        costs = rigid.differences(here + flow, self.patches, known)
        bad = costs > BAD
        chosen = np.flatnonzero(bad)
        moves, found = rigid.start(here, last, here + flow, self.patches, bad, known)
        for share in SHARES:
            rigid.sweep(here, self.patches, chosen, self.around, moves, found, share, known)
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
        """Every point moves with the best of its patches.

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
