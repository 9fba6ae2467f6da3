"""The static points of a reconstruction so far, and which of them are still there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from splatreel.scene.gaussians import Gaussians


@dataclass(frozen=True)
class StaticPoints:
    """points: all S that were static in some group, decoded, in reel order. alive: [S] bool, those that are static now.

    Points are never taken out, since a reel says of each whether a group shows it. A change gives a new value.
    """

    points: Gaussians
    alive: np.ndarray

    @staticmethod
    def none(sh_degree: int = 3) -> StaticPoints:
        return StaticPoints(Gaussians.empty(sh_degree), np.zeros(0, bool))

    @cached_property
    def living(self) -> Gaussians:
        """The A points that are static now."""
        return self.points[self.alive]

    def without(self, gone: np.ndarray) -> StaticPoints:
        """These points are no longer static. gone: [A] bool, of the living ones."""
        alive = self.alive.copy()
        alive[self.alive] = ~gone
        return self.with_alive(alive)

    def with_alive(self, alive: np.ndarray) -> StaticPoints:
        """The same points, of which others are static. alive: [S] bool."""
        return replace(self, alive=alive)

    def with_layer(self, decoded: Gaussians) -> StaticPoints:
        """And the points that became static at a group, as a reader of the reel sees them."""
        points = Gaussians.concatenate([self.points, decoded])
        return StaticPoints(points, np.concatenate([self.alive, np.ones(len(decoded), bool)]))
