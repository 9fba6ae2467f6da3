"""Gradients of the terms of surfaces to an image of depths, against finite differences."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from splatreel.method.train.terms import surfaces
from splatreel.method.train.terms.surfaces import Roughness, Spread, roughness
from splatreel.method.train.terms.term import MIN_ALPHA, Depths, Neighbors, depth_powers

SPAN = 3.0


def layered(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums [H, W, 3] and alpha [H, W] of three splats in each pixel; the first rows show nothing."""
    weights = np.random.default_rng(seed).uniform(0, 0.3, (12, 17, 3)).astype(np.float32)
    weights[:2] = 0
    return weights @ depth_powers(np.array([1.0, 2.0, 5.0], np.float32), 0.5), weights.sum(-1)


def depths_of(sums: np.ndarray, alpha: np.ndarray) -> Depths:
    shown = np.maximum(alpha, MIN_ALPHA)[..., None]
    return Depths(sums / shown, alpha, None, None, sums)  # type: ignore[arg-type]


def seen(depths: Depths, image: np.ndarray) -> Any:
    return SimpleNamespace(depths=depths, target=image, unit=SPAN, near=1.0)


@pytest.mark.parametrize("term", [Spread("spread"), Roughness("roughness")], ids=lambda term: term.name)
def test_gradients_are_finite_differences(term: Any) -> None:
    rng = np.random.default_rng(0)
    (sums, alpha), image = layered(), rng.integers(0, 256, (12, 17, 3), np.uint8)
    depths = depths_of(sums, alpha)
    far, factor = surfaces._layers(depths)  # held constant
    term.add_to_drawing(seen(depths, image), 0.7)
    d_sums, d_alpha = depths.to_drawing()

    def value(sums: np.ndarray, alpha: np.ndarray) -> float:
        moments = sums / np.maximum(alpha, MIN_ALPHA)[..., None]
        if isinstance(term, Roughness):
            return 0.7 * roughness(depths_of(sums, alpha), image, SPAN)
        return 0.7 * float((factor * (moments[..., 1] - 2 * far * moments[..., 0] + far * far)).mean())

    sums, alpha = sums.astype(np.float64), alpha.astype(np.float64)
    for of, gradient in ((0, d_sums), (1, d_alpha)):
        along = np.sign(gradient) * rng.uniform(0, 1e-5, gradient.shape)
        along[:2] = 0  # the gradient of log depths of nothing is not defined
        moved = [[sums, alpha], [sums, alpha]]
        moved[0][of], moved[1][of] = (sums, alpha)[of] + along, (sums, alpha)[of] - along
        change = (value(*moved[0]) - value(*moved[1])) / 2
        assert change == pytest.approx(float((gradient * along).sum()), rel=2e-2), of
    assert not d_sums[:2].any() or isinstance(term, Roughness)


def test_terms_of_one_iteration_share_the_image_of_depths() -> None:
    (sums, alpha), image = layered(), np.zeros((12, 17, 3), np.uint8)
    both, found = depths_of(sums, alpha), []
    for term in (Spread("spread"), Roughness("roughness")):
        alone = depths_of(sums, alpha)
        term.add_to_drawing(seen(alone, image), 0.5)
        term.add_to_drawing(seen(both, image), 0.5)
        found.append(alone.to_drawing())
    for both_of, first, second in zip(both.to_drawing(), *found, strict=True):
        np.testing.assert_allclose(both_of, first + second, rtol=1e-4, atol=1e-7)


def test_neighbors_are_ranked_and_weighted_by_distance():
    means = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0], [3, 0.1, 0]], np.float32)
    found = Neighbors.of(means, 8)
    assert found is not None
    assert found.index.shape == found.closeness.shape == (3, 4)
    assert found.closeness.dtype == np.float32
    assert found.index[0].tolist() == [1, 0, 3, 2]
    assert (found.closeness[0] > found.closeness[2]).all()
    assert Neighbors.of(means[:1], 8) is None
