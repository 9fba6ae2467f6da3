"""Gradients of the losses of surfaces, against those of torch."""

import numpy as np
import pytest
import torch

from splatreel.method.train.cpu_surfaces import depth_powers, surface_gradients
from splatreel.method.train.regularizers import MIN_ALPHA, Depths, roughness, spread


@pytest.mark.parametrize(("before", "bent"), [(0.7, 0.0), (0.0, 0.3), (0.7, 0.3)])
def test_gradients_are_those_of_torch(before: float, bent: float) -> None:
    rng, span = np.random.default_rng(0), 3.0
    weights = rng.uniform(0, 0.3, (12, 17, 3)).astype(np.float32)  # of three splats in each pixel
    weights[:2] = 0  # pixels that show nothing
    powers = depth_powers(np.array([1.0, 2.0, 5.0], np.float32), 0.5)
    image = rng.integers(0, 256, (12, 17, 3), np.uint8)
    sums, alpha = (torch.from_numpy(each).requires_grad_() for each in (weights @ powers, weights.sum(-1)))
    depths = Depths(sums / alpha.clamp_min(MIN_ALPHA)[..., None], alpha)
    (before * spread(depths) + bent * roughness(depths, torch.from_numpy(image), span)).backward()
    found = surface_gradients(sums.detach().numpy(), alpha.detach().numpy(), image, before, bent, span)
    for gradient, tensor in zip(found, (sums, alpha), strict=True):
        expected = tensor.grad.numpy()  # type: ignore[union-attr]
        assert np.abs(expected).max() > 1e-4
        np.testing.assert_allclose(gradient, expected, rtol=2e-3, atol=1e-3 * np.abs(expected).max())


def test_powers_are_of_log_depths_over_the_near_plane() -> None:
    found = depth_powers(np.array([0.1, 0.5, 0.5 * np.e**2], np.float32), 0.5)
    np.testing.assert_allclose(found, [[0, 0, 0], [0, 0, 0], [2, 4, 8]], atol=1e-5)
