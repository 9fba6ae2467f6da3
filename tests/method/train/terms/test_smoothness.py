"""Smoothness of motion: acceleration costs, speed does not."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from splatreel.method.train.terms.smoothness import Smoothness


class Polynomial:
    """Deformation with offsets t^power."""

    def __init__(self, power: int) -> None:
        self.power = power

    def offsets(self, means: np.ndarray, frame: float) -> tuple[np.ndarray, np.ndarray]:
        return np.full_like(means, float(frame) ** self.power), np.ones((len(means), 4), np.float32)


def cost(power: int) -> float:
    points = {"means": np.zeros((5, 3), np.float32)}
    seen = SimpleNamespace(points=points, span=(2, 4, 0.3), unit=1.0, deformation=Polynomial(power))
    return Smoothness("smoothness").value(cast(Any, seen))


def test_only_acceleration_costs() -> None:
    assert cost(1) < 1e-5
    assert cost(2) == pytest.approx(3 * abs(0.7 * 4 + 0.3 * 16 - 2.6**2), rel=1e-4)
