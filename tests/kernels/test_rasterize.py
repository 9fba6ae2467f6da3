"""The rasterizer compared with the twin and with known answers; its determinism and independent calls."""

# pyright: reportCallIssue=false
# Pyright assumes that an unpacked list fills all remaining positional arguments.

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base import threads
from splatreel.base.errors import GaussiansError
from splatreel.kernels import splat, twin
from splatreel.kernels import binning
from splatreel.kernels.splat import Splats
from tests.kernels.compare import assert_parity, splats


def parity(inputs, width, height, tolerance=3e-5):
    *values, depths, radii = inputs
    assert_parity(
        lambda *a: splat.rasterize(Splats(*a, depths, radii), width, height),
        lambda *a: twin.rasterize(Splats(*a, depths, radii), width, height),
        values,
        tolerance,
    )


@pytest.mark.parametrize("channels", [1, 2, 3, 5, 6])
@pytest.mark.parametrize(("width", "height"), [(37, 29), (16, 32), (1, 1), (5, 50)])
def test_rasterize_equals_twin(channels, width, height):
    parity(splats(150, channels, width, height, seed=channels), width, height)


@pytest.mark.parametrize("opacity", [0.97, 0.9999, 1.0])
def test_rasterize_equals_twin_for_full_pixels(opacity):
    """Alphas exceed the clamp at 0.999, and pixels are full long before the last splat."""
    inputs = splats(300, 3, 40, 30)
    inputs.opacities.fill_(opacity)
    alpha = splat.rasterize(inputs, 40, 30)[1]
    assert (alpha > 0.99).float().mean() > 0.5
    parity(inputs, 40, 30, 1e-4)


def test_rasterize_equals_twin_for_huge_splats():
    inputs = splats(40, 3, 50, 34)
    inputs[1][:5] = torch.tensor([1e-6, 0, 1e-6])
    inputs[0][:2] = torch.tensor([1e4, -1e4])
    parity(inputs, 50, 34)


def test_absolute_gradient_is_a_sum_over_tiles():
    """It equals the sum of the absolute gradients of losses that each see one tile of 16 x 16 pixels."""
    width, height, size = 50, 34, binning.TILE
    means2d, *others = splats(80, 3, width, height)
    slopes = torch.randn(height, width, 3, generator=torch.Generator().manual_seed(3))
    expected = torch.zeros_like(means2d)
    for top in range(0, height, size):
        for left in range(0, width, size):
            mean = means2d.clone().requires_grad_()
            image, _ = splat.rasterize(Splats(mean, *others), width, height)
            part = slice(top, top + size), slice(left, left + size)
            (image * slopes)[part].sum().backward()
            expected += mean.grad.abs()
    mean, absolute = means2d.clone().requires_grad_(), torch.zeros_like(means2d, requires_grad=True)
    image, _ = splat.rasterize(Splats(mean, *others), width, height, absolute)
    (image * slopes).sum().backward()
    torch.testing.assert_close(absolute.grad, expected, rtol=2e-4, atol=2e-4)
    assert (absolute.grad >= mean.grad.abs() - 1e-3).all()
    assert absolute.grad.sum() > 1.2 * mean.grad.abs().sum(), "gradients of different tiles cancel each other"


def test_single_splat_has_gaussian_alpha():
    """At its center, the alpha of a splat is its opacity; one sigma away it is exp(-1/2) times as much."""
    one = [torch.tensor(v) for v in ([[8.5, 8.5]], [[1 / 4, 0, 1 / 4]], [[0.5, 1, 0.25]], [0.8], [1.0])]
    image, alpha = splat.rasterize(Splats(*one, torch.ones(1, dtype=torch.int32)), 20, 20)
    torch.testing.assert_close(alpha[8, 8], torch.tensor(0.8))
    torch.testing.assert_close(alpha[8, 10], torch.tensor(0.8 * float(np.exp(-0.5))))
    torch.testing.assert_close(image[8, 8], 0.8 * torch.tensor([0.5, 1, 0.25]))
    assert alpha[0, 0] == 0  # below 1/255


def test_nearer_splat_is_drawn_in_front():
    two = [
        torch.tensor([[8.5, 8.5]] * 2),
        torch.tensor([[0.1, 0, 0.1]] * 2),
        torch.eye(3)[:2],
        torch.tensor([0.9, 0.9]),
    ]
    for depths, front in (([1.0, 2], 0), ([2.0, 1], 1)):
        image, _ = splat.rasterize(Splats(*two, torch.tensor(depths), torch.ones(2, dtype=torch.int32)), 16, 16)
        torch.testing.assert_close(image[8, 8, front], torch.tensor(0.9))
        torch.testing.assert_close(image[8, 8, 1 - front], torch.tensor(0.09))


@pytest.mark.parametrize("n", [0, 4])
def test_rasterize_without_visible_splats_is_black(n):
    inputs = splats(n, 3, 20, 20)
    inputs.radii.zero_()
    colors = inputs.colors.requires_grad_()
    image, alpha = splat.rasterize(inputs, 20, 20)
    assert not image.any()
    assert not alpha.any()
    image.sum().backward()
    assert colors.grad is not None
    assert colors.grad.shape == (n, 3)
    assert not colors.grad.any()


@pytest.mark.parametrize("index", [0, 1, 2, 3])
def test_rasterize_rejects_nan(index):
    inputs = splats(5, 3, 20, 20)
    inputs[index][(1,) * inputs[index].ndim] = float("nan")
    with pytest.raises(GaussiansError, match="NaN"):
        splat.rasterize(inputs, 20, 20)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 80), st.integers(1, 40), st.integers(1, 40))
def test_random_scene_equals_twin(seed, n, width, height):
    """Alpha is in 0..1. The image equals the twin's, except for rare pixels where rounding crosses the cut at 1/255."""
    inputs = splats(n, 3, width, height, seed)
    image, alpha = splat.rasterize(inputs, width, height)
    expected, expected_alpha = twin.rasterize(inputs, width, height)
    assert float(alpha.min()) >= 0
    assert float(alpha.max()) <= 1
    error = torch.cat([(image - expected).abs().view(-1), (alpha - expected_alpha).abs().view(-1)])
    assert float(error.max()) < 2 / 255
    assert int((error > 1e-5).sum()) <= 4


def test_rasterize_bits_do_not_depend_on_threads():
    inputs = splats(500, 3, 100, 70)

    def run():
        leaves = [t.clone().requires_grad_() for t in inputs[:4]]
        image, alpha = splat.rasterize(Splats(*leaves, *inputs[4:]), 100, 70)
        (image.square().sum() + alpha.sum()).backward()
        return [image, alpha, *(leaf.grad for leaf in leaves)]

    found = []
    for number in (1, 2, 4, 16):
        with threads.limited(number):
            found.append(run())
    for others in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], others, strict=True))


def test_concurrent_renders_are_independent():
    a, b = splats(100, 3, 40, 30, 1), splats(200, 3, 40, 30, 2)

    def gradient(inputs, between) -> Any:
        means2d = inputs.means2d.clone().requires_grad_()
        image, _ = splat.rasterize(inputs._replace(means2d=means2d), 40, 30)
        between()
        image.square().sum().backward()
        return means2d.grad

    alone = gradient(a, lambda: None)
    assert torch.equal(alone, gradient(a, lambda: gradient(b, lambda: None)))


def test_in_place_change_of_saved_tensor_raises():
    inputs = splats(20, 3, 20, 20)
    inputs.means2d.requires_grad_()
    image, _ = splat.rasterize(inputs, 20, 20)
    image *= 2
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.sum().backward()


def test_bins_are_complete_and_front_to_back():
    means2d, conics, _, opacities, depths, radii = (t.contiguous().numpy() for t in splats(300, 3, 70, 50))
    bins = binning.bin_splats(means2d, conics, opacities, depths, radii, 70, 50)
    assert sorted(bins.slots) == list(range(len(bins.ids)))
    for tile in range(5 * 4):
        ids = bins.ids[bins.offsets[tile] : bins.offsets[tile + 1]]
        keys = list(zip(depths[ids], ids, strict=True))
        assert keys == sorted(keys)  # equal depths in the order of the input
    assert not set(bins.ids) & set(np.flatnonzero(radii == 0))


def test_bins_cover_the_ellipse_of_each_splat():
    """Compared with the alpha of every pixel, no visible row is left out and few invisible rows are kept."""
    means2d, conics, _, opacities, depths, radii = (t.contiguous().numpy() for t in splats(300, 3, 70, 50))
    conics[:40] = [[0.5, 0.49, 0.5], [0.02, 0, 3]] * 20  # long and thin
    bins = binning.bin_splats(means2d, conics, opacities, depths, radii, 70, 50)
    x, y = np.meshgrid(np.arange(80) + 0.5, np.arange(64) + 0.5)
    rows = np.zeros((300, 10, 4, 16), bool)
    for tile in range(5 * 4):
        for pair in range(bins.offsets[tile], bins.offsets[tile + 1]):
            for half, packed in enumerate(bins.rows[pair]):
                strip = 2 * (tile % 5) + half
                rows[bins.ids[pair], strip, tile // 5, packed // 16 : packed % 16 + 1] = True
    dx, dy = x - means2d[:, :1, None], y - means2d[:, 1:, None]
    a, b, c = (conics[:, k, None, None].astype(float) for k in range(3))
    shows = opacities[:, None, None] * np.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy) >= 1 / 255
    shows &= (x < 70) & (y < 50) & (radii > 0)[:, None, None]
    expected = shows.reshape(300, 4, 16, 10, 8).any(-1).transpose(0, 3, 1, 2)
    assert not (expected & ~rows).any()
    assert (rows & ~expected).sum() < 0.15 * expected.sum()


def test_second_process_loads_cached_kernels():
    """A second process loads the compiled kernels from the cache on disk and does not compile again."""
    program = (
        "import time, numpy as np; start = time.process_time()\n"
        "from splatreel.kernels import binning, blending, rasterize\n"
        "f = np.float32; m = np.full((3, 2), 8, f); c = np.tile(np.array([.2, 0, .2], f), (3, 1)); o = np.ones(3, f)\n"
        "bins = binning.bin_splats(m, c, o, o, np.ones(3, np.int32), 16, 16); colors = np.ones((3, 3), f)\n"
        "image, alpha = rasterize.forward(bins, colors)\n"
        "rasterize.backward(bins, colors, image, image, alpha, alpha)\n"
        "hits = sum(sum(k.stats.cache_misses.values()) for k in (blending.forward.dispatcher, blending.backward.dispatcher))\n"
        "print(hits, time.process_time() - start)"
    )
    for _ in range(2):
        out = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, env=os.environ, check=True
        )
    misses, seconds = out.stdout.split()
    assert misses == "0"
    assert float(seconds) < 5  # 0.4 s on a free core
