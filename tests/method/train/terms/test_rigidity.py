"""Rigidity: what it costs, and what is free."""

import numpy as np
import pytest

from splatreel.kernels import motion
from splatreel.method.train.trainable_points import rotate

AXIS = np.linspace(-1, 1, 4, dtype=np.float32)
GRID = np.stack(np.meshgrid(AXIS, AXIS, AXIS, indexing="ij"), -1).reshape(-1, 3)
STILL = np.tile(np.array([1, 0, 0, 0], np.float32), (len(GRID), 1))


def cost(means: np.ndarray, dx: np.ndarray, dq: np.ndarray, unit: float = 1.0) -> float:
    neighbor = np.arange(1, len(means) + 1) % len(means)
    means, dx, dq = (np.ascontiguousarray(each, np.float32) for each in (means, dx, dq))
    return motion.arap(means, dx, dq, neighbor, np.ones(len(means), np.float32), unit)[0]


def test_rigid_motion_is_free() -> None:
    dq = np.tile(np.array([0.8, 0, 0.6, 0], np.float32), (len(GRID), 1))
    dx = rotate(dq, GRID) + np.array([0.3, -0.2, 0.5], np.float32) - GRID
    assert cost(GRID, dx, dq) < 1e-4


@pytest.mark.parametrize("kind", ["stretch", "twist"])
def test_stretching_and_twisting_cost(kind: str) -> None:
    dq, dx = STILL.copy(), np.zeros_like(GRID)
    if kind == "stretch":
        dx = 0.2 * GRID
    else:
        dq[::2] = [0.8, 0.6, 0, 0]
    assert cost(GRID, dx, dq) > 0.05


def test_cost_is_independent_of_scale() -> None:
    dx = 0.1 * np.sin(GRID)
    assert cost(GRID, dx, STILL) == pytest.approx(cost(1000 * GRID, 1000 * dx, STILL, 1000.0), rel=1e-3)
