"""Static Gaussians of a reconstruction, and which of them are alive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from splatreel.scene.gaussians import Gaussians


@dataclass(frozen=True)
class StaticPoints:
    """All static Gaussians so far and their alive flags.

    Gaussians are never removed, because a reel stores a flag for each of them. Every change returns a new object.

    Attributes:
        points: All S Gaussians that became static in some group, decoded, in reel order.
        alive: Gaussians that are static now, [S] bool.
    """

    points: Gaussians
    alive: np.ndarray

    @staticmethod
    def none(sh_degree: int = 3) -> StaticPoints:
        """Return an object without Gaussians."""
        return StaticPoints(Gaussians.empty(sh_degree), np.zeros(0, bool))

    @cached_property
    def living(self) -> Gaussians:
        """The A Gaussians that are static now."""
        return self.points[self.alive]

    def without(self, gone: np.ndarray) -> StaticPoints:
        """Return the object with some living Gaussians, `gone` [A] bool, no longer alive."""
        alive = self.alive.copy()
        alive[self.alive] = ~gone
        return self.with_alive(alive)

    def with_alive(self, alive: np.ndarray) -> StaticPoints:
        """Return the object with other alive flags, [S] bool."""
        return replace(self, alive=alive)

    def with_layer(self, decoded: Gaussians) -> StaticPoints:
        """Return the object with a decoded layer appended, all of it alive."""
        points = Gaussians.concatenate([self.points, decoded])
        return StaticPoints(points, np.concatenate([self.alive, np.ones(len(decoded), bool)]))
