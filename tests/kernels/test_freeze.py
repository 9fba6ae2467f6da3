"""Drawing moving splats among frozen splats gives the image and the gradients of drawing everything."""

# pyright: reportCallIssue=false
# Pyright assumes that an unpacked list fills all remaining positional arguments.

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.kernels import rasterize, splat
from splatreel.kernels.splat import Splats
from tests.kernels.compare import slopes

WIDTH, HEIGHT = 100, 70


def splats(count, seed, spread=None):
    state = np.random.RandomState(seed)
    middle, size = spread or ((WIDTH / 2, HEIGHT / 2), 1.2)
    means = np.array(middle) + (state.rand(count, 2) - 0.5) * size * np.array([WIDTH, HEIGHT])
    root = state.rand(count, 3) * 0.5 + np.array([0.2, -0.25, 0.2])
    conics = np.stack([root[:, 0] ** 2, 0.3 * root[:, 0] * root[:, 1], root[:, 2] ** 2], 1)
    arrays = means, conics, state.rand(count, 3), state.rand(count), state.rand(count) + 1
    return Splats(*(array.astype(np.float32) for array in arrays), np.full(count, 24, np.int32))


def draw(moving, frozen=None):
    """Return the image, alpha and the gradients to the splats."""
    image, alpha = splat.rasterize(moving, WIDTH, HEIGHT, frozen)
    return image, alpha, splat.rasterize_gradient(moving, WIDTH, HEIGHT, image, alpha, *slopes((image, alpha)), frozen)


def pixels(tiles):
    """Return which pixels are in tiles [5, 7]."""
    return np.kron(tiles.reshape(5, 7), np.ones((16, 16), bool))[:HEIGHT, :WIDTH]


@pytest.mark.parametrize("faint", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_drawing_among_frozen_splats_equals_drawing_everything(seed, faint):
    static, moving = splats(400, seed), splats(30, seed + 100, ((30.0, 40.0), 0.3))
    static.depths[:20] = moving.depths[:20]  # at equal depth, moving splats are in front
    if not faint:
        static.opacities[:], moving.opacities[:] = 0.97, 0.9  # pixels fill up
    image, alpha, expected = draw(Splats.join(moving, static))
    drawn, opacity, found = draw(moving, splat.freeze(static, WIDTH, HEIGHT))
    np.testing.assert_allclose(drawn, image, rtol=1e-3, atol=2e-6)
    np.testing.assert_allclose(opacity, alpha, rtol=1e-3, atol=2e-6)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b[:30], rtol=1e-3, atol=1e-5 * np.abs(b).max())


def test_only_touched_tiles_are_drawn_again():
    static, moving = splats(400, 0), splats(30, 100, ((30.0, 40.0), 0.3))
    frozen = splat.freeze(static, WIDTH, HEIGHT)
    image, alpha = splat.rasterize(moving, WIDTH, HEIGHT, frozen)
    tiles = splat.bin(moving, WIDTH, HEIGHT).counts > 0
    assert 0.1 < tiles.mean() < 0.9
    kept = ~pixels(tiles)
    np.testing.assert_array_equal(image[kept], frozen.image[kept])
    np.testing.assert_array_equal(alpha[kept], frozen.alpha[kept])
    expected, _ = splat.rasterize(Splats.join(moving, static), WIDTH, HEIGHT)
    assert np.abs(frozen.image - expected).max() > 0.1
    _, alone = splat.rasterize(moving, WIDTH, HEIGHT)
    assert not alone[kept].any()


def test_drawing_no_splats_keeps_frozen_image():
    frozen = splat.freeze(splats(50, 0), WIDTH, HEIGHT)
    image, alpha, gradients = draw(splats(0, 1), frozen)
    np.testing.assert_array_equal(image, frozen.image)
    np.testing.assert_array_equal(alpha, frozen.alpha)
    assert all(len(gradient) == 0 for gradient in gradients)


def test_drawing_among_no_frozen_splats_is_drawing_alone():
    moving = splats(50, 0)
    for a, b in zip(draw(moving, splat.freeze(splats(0, 1), WIDTH, HEIGHT))[:2], draw(moving)[:2], strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_removed_splats_are_not_drawn():
    static = splats(400, 0)
    frozen, rows = splat.freeze(static, WIDTH, HEIGHT), np.arange(400)
    for gone in (rows[::7], rows[3:40:2]):
        rasterize.remove(frozen, gone)
        rows = rows[~np.isin(rows, gone)]
        others = splat.freeze(static.rows(rows), WIDTH, HEIGHT)
        np.testing.assert_allclose(frozen.image, others.image, atol=1e-6)
        np.testing.assert_allclose(frozen.alpha, others.alpha, atol=1e-6)
    assert len(rows) < 340


def test_frozen_splats_and_splats_among_them_must_be_finite():
    static, moving = splats(5, 0), splats(5, 1)
    frozen = splat.freeze(static, WIDTH, HEIGHT)
    moving.means2d[2, 1] = np.nan
    with pytest.raises(GaussiansError, match="means2d holds 1 value"):
        splat.rasterize(moving, WIDTH, HEIGHT, frozen)
    with pytest.raises(GaussiansError, match="means2d"):
        splat.freeze(moving, WIDTH, HEIGHT)
