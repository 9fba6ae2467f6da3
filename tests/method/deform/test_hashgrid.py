"""Gradients of the hash grid's network, and its start."""

import numpy as np

from splatreel.method.deform.hashgrid import HashGrid, _decode, _decode_gradient


def test_network_gradient_is_that_of_finite_differences() -> None:
    """In double precision every value of every parameter and feature agrees."""
    rng = np.random.default_rng(0)
    net = HashGrid(rng.uniform(-1, 1, (5, 3)).astype(np.float32), 5, 1.0)
    names = [name for name in net.adams if not name.startswith("grid")]
    values = {name: rng.normal(0, 0.3, net.adams[name].parameter.shape) for name in names}
    features = [rng.normal(size=(4, 24)) for _ in range(4)]
    weights = rng.normal(size=(4, 3)), rng.normal(size=(4, 4))

    def loss() -> float:
        return sum(
            float((head * weight).sum()) for head, weight in zip(_decode(values, features)[-1], weights, strict=True)
        )

    found, d_features = _decode_gradient(values, features, weights)
    assert sorted(found) == sorted(names)
    pairs = [*((values[name], found[name]) for name in names), *zip(features, d_features, strict=True)]
    for value, slope in pairs:
        assert value.shape == slope.shape
        for place in rng.integers(value.size, size=12):
            before, ends = value.flat[place], []
            for sign in (1, -1):
                value.flat[place] = before + sign * 1e-6
                ends.append(loss())
            value.flat[place] = before
            np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, slope.flat[place], rtol=1e-5, atol=1e-8)


def test_seed_decides_the_start() -> None:
    means = np.random.default_rng(0).uniform(-1, 1, (50, 3)).astype(np.float32)
    first, same, other = (HashGrid(means, 5, 1.0, seed).offsets(means, 2)[0] for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, same)
    assert (first != other).any()


def test_moments_share_one_gradient_of_the_parameters() -> None:
    """The sum of the gradients at each moment equals that at all moments together."""
    means = np.random.default_rng(0).uniform(-1, 1, (50, 3)).astype(np.float32)
    net, d_dx, d_dq = HashGrid(means, 5, 1.0), np.ones((50, 3), np.float32), np.ones((50, 4), np.float32)
    moments = [(0.5, 1.0), (-2.0, 3.5)]
    [together] = net.gradient(means, moments, d_dx, d_dq)
    apart = [net.gradient(means, [moment], d_dx, d_dq)[0] for moment in moments]
    for name, value in together.parameters.items():
        total = apart[0].parameters[name] + apart[1].parameters[name]
        np.testing.assert_allclose(value, total, rtol=1e-4, atol=1e-5 * np.abs(total).max())
