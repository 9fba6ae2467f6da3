"""Opacity resets of a first keyframe, and pruning of the points that recover least from a reset.

A reset makes all points faint. Points that images need become opaque again within a few dozen iterations. Points behind others,
points in front of a surface and points next to similar ones do not. Opacity tells them apart only after a reset.

Source:
    Recovery-aware pruning of Improved-GS (Deng et al. 2025).
"""

from __future__ import annotations

import math

import numpy as np

from splatreel.method.train.trainable_points import TrainablePoints

RESET_AT = (0.25, 0.45)
"""Shares of training after which opacities are reset (docs/experiments/2026-11-28-pruning-and-view-scores.md)."""
RESET_OPACITY = 0.05
"""Maximum opacity after a reset."""
PRUNED_SHARE = 0.2
"""Share of all points that is pruned after each reset."""
RECOVERY = 40
"""Minimum number of iterations between a reset and the pruning."""
RECOVERY_ROUNDS = 1.5
"""Minimum number of times that each view is drawn between a reset and the pruning. A point recovers only in views that see it."""
MAX_RECOVERY = 0.1
"""Share of training above which recovery takes too long. Opacities are then never reset."""


class OpacityResets:
    """Times of the resets and prunings of one training.

    Attributes:
        resets: Numbers of finished iterations after which opacities are reset.
        prunings: Numbers of finished iterations after which points are pruned.
    """

    def __init__(self, total: int, views: int) -> None:
        """Choose the times.

        Args:
            total: Iterations of training.
            views: Number of training views.
        """
        wait = max(RECOVERY, math.ceil(RECOVERY_ROUNDS * views))
        self.resets = [round(at * total) for at in RESET_AT] if wait <= MAX_RECOVERY * total else []
        self.prunings = [done + wait for done in self.resets]

    def is_due(self, done: int) -> bool:
        """Return whether `update` changes points after `done` iterations."""
        return done in self.resets or done in self.prunings

    def update(self, done: int, points: TrainablePoints) -> bool:
        """Reset opacities or prune points after `done` iterations, if due. Return whether points were pruned."""
        if done in self.resets:
            reset_opacities(points)
        if done not in self.prunings:
            return False
        points.keep(~faintest(points))
        return True


def reset_opacities(points: TrainablePoints) -> None:
    """Lower all opacities to at most `RESET_OPACITY`, and restart their optimizer state."""
    highest = math.log(RESET_OPACITY / (1 - RESET_OPACITY))
    points.adams["logit_opacities"].rewrite(lambda logits: np.minimum(logits, np.float32(highest)), np.zeros_like)


def faintest(points: TrainablePoints) -> np.ndarray:
    """Return the mask [N] of the faintest `PRUNED_SHARE` of all points."""
    opacities = points.opacities
    return opacities < np.quantile(opacities, PRUNED_SHARE)
