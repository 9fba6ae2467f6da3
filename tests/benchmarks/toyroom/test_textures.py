from itertools import pairwise

import numpy as np

from toyroom.textures import CHECKS, GRAINED, albedo

COLORS = ((0.5, 0.4, 0.3), (0.2, 0.2, 0.6), (0.9, 0.9, 0.9))


def colors(kind: int, points: np.ndarray) -> np.ndarray:
    """Return colors [N, 3] of a front face."""
    half = (1.0, 1.0, 1.0)
    return np.array([albedo(float(kind), *point, 0.0, 0.0, 1.0, half, COLORS, 3.0, 0.1) for point in points])  # pyright: ignore[reportCallIssue]


def test_grain_scales_the_pattern() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (4000, 3))
    factor = colors(CHECKS + GRAINED, points) / colors(CHECKS, points)
    assert np.allclose(factor, factor[:, :1])
    assert abs(factor.mean() - 1) < 0.05
    assert 0.08 < factor[:, 0].std() < 0.3
    assert factor.min() > 0


def test_grain_has_all_frequencies() -> None:
    """At half the distance colors differ less, but by more than half, unlike in a smooth texture."""
    points = np.random.default_rng(1).uniform(-1, 1, (4000, 3))

    def grain(moved: float) -> np.ndarray:
        shifted = points + np.array([moved, 0, 0])
        return (colors(CHECKS + GRAINED, shifted) / colors(CHECKS, shifted))[:, 0]

    apart = [np.square(grain(distance) - grain(0)).mean() ** 0.5 for distance in (0.02, 0.04, 0.08)]
    assert all(1.1 < more / less < 1.9 for less, more in pairwise(apart))
