"""The rasterizer: known answers, determinism, sorting into tiles, and sums over splats."""

# pyright: reportCallIssue=false
# Pyright assumes that an unpacked list fills all remaining positional arguments.

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base import threads
from splatreel.base.errors import GaussiansError
from splatreel.kernels import binning, splat
from splatreel.kernels.splat import Projection, Splats
from tests.kernels.cases import normal
from tests.kernels.compare import floats, slopes, splats


def test_absolute_gradient_is_a_sum_over_tiles():
    """It equals the sum of the absolute gradients of losses that each see one tile of 16 x 16 pixels."""
    width, height, size = 50, 34, binning.TILE
    drawn, d_image = splats(80, 3, width, height), normal(height, width, 3, seed=3)
    image, alpha = splat.rasterize(drawn, width, height)
    expected = np.zeros_like(drawn.means2d)
    for top in range(0, height, size):
        for left in range(0, width, size):
            part = np.zeros_like(d_image)
            tile = slice(top, top + size), slice(left, left + size)
            part[tile] = d_image[tile]
            expected += np.abs(splat.rasterize_gradient(drawn, width, height, image, alpha, part).means2d)
    found = splat.rasterize_gradient(drawn, width, height, image, alpha, d_image)
    np.testing.assert_allclose(found.absolute, expected, rtol=2e-4, atol=2e-4)
    assert (found.absolute >= np.abs(found.means2d) - 1e-3).all()
    assert found.absolute.sum() > 1.2 * np.abs(found.means2d).sum(), "gradients of different tiles cancel each other"


def test_single_splat_has_gaussian_alpha():
    """At its center, the alpha of a splat is its opacity; one sigma away it is exp(-1/2) times as much."""
    one = [floats(v) for v in ([[8.5, 8.5]], [[1 / 4, 0, 1 / 4]], [[0.5, 1, 0.25]], [0.8], [1.0])]
    image, alpha = splat.rasterize(Splats(*one, np.ones(1, np.int32)), 20, 20)
    assert alpha[8, 8] == pytest.approx(0.8)
    assert alpha[8, 10] == pytest.approx(0.8 * np.exp(-0.5), rel=1e-5)
    np.testing.assert_allclose(image[8, 8], 0.8 * np.array([0.5, 1, 0.25]), rtol=1e-5)
    assert alpha[0, 0] == 0  # below 1/255


def test_nearer_splat_is_drawn_in_front():
    two = [floats(v) for v in ([[8.5, 8.5]] * 2, [[0.1, 0, 0.1]] * 2, np.eye(3)[:2], [0.9, 0.9])]
    for depths, front in (([1.0, 2], 0), ([2.0, 1], 1)):
        image, _ = splat.rasterize(Splats(*two, floats(depths), np.ones(2, np.int32)), 16, 16)
        assert image[8, 8, front] == pytest.approx(0.9, rel=1e-5)
        assert image[8, 8, 1 - front] == pytest.approx(0.09, rel=1e-4)


def test_pixels_of_opaque_splats_are_full():
    """The recorded cases of full pixels have pixels that are full."""
    inputs = splats(300, 3, 40, 30)
    inputs.opacities[:] = 0.97
    assert (splat.rasterize(inputs, 40, 30)[1] > 0.99).mean() > 0.5


@pytest.mark.parametrize("n", [0, 4])
def test_rasterize_without_visible_splats_is_black(n):
    inputs = splats(n, 3, 20, 20)
    inputs.radii[:] = 0
    image, alpha = splat.rasterize(inputs, 20, 20)
    assert not image.any()
    assert not alpha.any()
    found = splat.rasterize_gradient(inputs, 20, 20, image, alpha, np.ones_like(image))
    assert found.colors.shape == (n, 3)
    assert not found.colors.any()


@pytest.mark.parametrize("channels", [1, 4, 6])
def test_channels_are_drawn_alike(channels):
    inputs = splats(60, channels, 30, 20)
    image, alpha = splat.rasterize(inputs, 30, 20)
    assert image.shape == (20, 30, channels)
    alone = inputs._replace(colors=np.repeat(inputs.colors[:, -1:], 3, 1))
    np.testing.assert_array_equal(image[..., -1], splat.rasterize(alone, 30, 20)[0][..., 0])
    d_alpha = np.ones_like(alpha)
    found = splat.rasterize_gradient(inputs, 30, 20, image, alpha, np.zeros_like(image), d_alpha)
    once = splat.rasterize_gradient(
        alone, 30, 20, splat.rasterize(alone, 30, 20)[0], alpha, np.zeros((20, 30, 3), np.float32), d_alpha
    )
    np.testing.assert_allclose(found.opacities, once.opacities, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("index", [0, 1, 2, 3])
def test_rasterize_rejects_nan(index):
    inputs = splats(5, 3, 20, 20)
    inputs[index][(1,) * inputs[index].ndim] = np.nan
    with pytest.raises(GaussiansError, match="NaN"):
        splat.rasterize(inputs, 20, 20)


def by_formula(inputs, width, height):
    """Blend every splat at every pixel in float64, front to back."""
    means2d, conics, colors, opacities, depths, radii = (array.astype(np.float64) for array in inputs)
    y, x = np.mgrid[:height, :width] + 0.5
    image, left, full = np.zeros((height, width, 3)), np.ones((height, width)), np.zeros((height, width), bool)
    for i in np.argsort(depths, kind="stable"):
        if radii[i] > 0:
            dx, dy = x - means2d[i, 0], y - means2d[i, 1]
            a, b, c = conics[i]
            alpha = np.minimum(opacities[i] * np.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy), 0.999)
            alpha[alpha < 1 / 255] = 0
            full |= left * (1 - alpha) <= 1e-4
            alpha[full] = 0
            image += (alpha * left)[..., None] * colors[i]
            left *= 1 - alpha
    return image, 1 - left


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 80), st.integers(1, 40), st.integers(1, 40))
def test_random_scene_equals_formula(seed, n, width, height):
    """Alpha is in 0..1. The image equals the formula's, except for rare pixels where rounding crosses the cut at 1/255."""
    inputs = splats(n, 3, width, height, seed)
    image, alpha = splat.rasterize(inputs, width, height)
    expected, expected_alpha = by_formula(inputs, width, height)
    assert alpha.min() >= 0
    assert alpha.max() <= 1
    error = np.concatenate([np.abs(image - expected).reshape(-1), np.abs(alpha - expected_alpha).reshape(-1)])
    assert error.max() < 2 / 255
    assert (error > 1e-5).sum() <= 4


def test_rasterize_bits_do_not_depend_on_threads():
    inputs, found = splats(500, 3, 100, 70), []
    for number in (1, 2, 4, 16):
        with threads.limited(number):
            image, alpha = splat.rasterize(inputs, 100, 70)
            d_image, d_alpha = slopes((image, alpha))
            gradients = splat.rasterize_gradient(inputs, 100, 70, image, alpha, d_image, d_alpha)
            found.append((image, alpha, *gradients))
    for others in found[1:]:
        for a, b in zip(found[0], others, strict=True):
            np.testing.assert_array_equal(a, b)


def projected(found: Splats) -> Projection:
    return Projection(found.means2d, found.conics, found.depths, found.radii)


@pytest.mark.parametrize("channels", [1, 3, 12, 13])
def test_gather_equals_gradient_to_colors(channels):
    found, images = splats(100, channels, 37, 29, seed=channels), normal(29, 37, channels)
    image, alpha = splat.rasterize(found, 37, 29)
    expected = splat.rasterize_gradient(found, 37, 29, image, alpha, images).colors
    np.testing.assert_allclose(
        splat.gather(projected(found), found.opacities, images), expected, rtol=1e-3, atol=3e-5 * np.abs(expected).max()
    )


def test_gather_without_splats_or_channels():
    found, images = splats(20, 3, 10, 10), np.ones((10, 10, 2), np.float32)
    assert splat.gather(projected(found), found.opacities, images[..., :0]).shape == (20, 0)
    nothing = found.rows(np.arange(0))
    assert splat.gather(projected(nothing), nothing.opacities, images).shape == (0, 2)


def test_gather_refuses_nan():
    found = splats(20, 3, 10, 10)
    found.means2d[3, 0] = np.nan
    with pytest.raises(GaussiansError, match="means2d holds 1"):
        splat.gather(projected(found), found.opacities, np.ones((10, 10, 2), np.float32))


def test_bins_are_complete_and_front_to_back():
    means2d, conics, _, opacities, depths, radii = splats(300, 3, 70, 50)
    bins = binning.bin_splats(means2d, conics, opacities, depths, radii, 70, 50)
    assert sorted(bins.slots) == list(range(len(bins.ids)))
    for tile in range(5 * 4):
        ids = bins.ids[bins.offsets[tile] : bins.offsets[tile + 1]]
        keys = list(zip(depths[ids], ids, strict=True))
        assert keys == sorted(keys)  # equal depths in the order of the input
    assert not set(bins.ids) & set(np.flatnonzero(radii == 0))


def test_bins_cover_the_ellipse_of_each_splat():
    """Compared with the alpha of every pixel, no visible row is left out and few invisible rows are kept."""
    means2d, conics, _, opacities, depths, radii = splats(300, 3, 70, 50)
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
