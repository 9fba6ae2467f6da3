"""The layered loss equals the loss of the whole image up to a constant, and restores the frozen image."""

import numpy as np
import pytest

from splatreel.kernels import layered, rasterize, similarity, splat
from splatreel.kernels.rasterize import Gradients
from splatreel.kernels.splat import Splats
from tests.kernels.compare import floats
from tests.kernels.test_freeze import HEIGHT, WIDTH, splats

GAIN, BACKGROUND = floats([0.9, 1.0, 1.1]), floats([0.1, 0.2, 0.3])


def scene(seed):
    target = np.random.RandomState(seed).randint(256, size=(HEIGHT, WIDTH, 3)).astype(np.uint8)
    frozen = splat.freeze(splats(400, seed), WIDTH, HEIGHT)
    return splats(30, seed + 100, ((30.0, 40.0), 0.3)), frozen, target


def whole(drawn, target, frozen=None) -> tuple[float, Gradients]:
    """Return the loss of the whole image and its gradients."""
    image, alpha = splat.rasterize(drawn, WIDTH, HEIGHT, frozen)
    found = similarity.loss_and_gradient(image, target, 0.2, GAIN, background=BACKGROUND)
    return found.loss, splat.rasterize_gradient(drawn, WIDTH, HEIGHT, image, alpha, found.d_image, frozen=frozen)


def layered_loss(drawn, frozen, target, **options) -> tuple[float, Gradients]:
    bins = splat.bin(drawn, WIDTH, HEIGHT)
    return layered.loss_and_gradient(bins, drawn.colors, frozen, target, 0.2, GAIN, BACKGROUND, **options)


def assert_close(found, expected):
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6 * np.abs(b).max())
        assert b.any()


@pytest.mark.parametrize("seed", range(3))
def test_layered_gradients_equal_those_of_whole_image(seed):
    moving, frozen, target = scene(seed)
    loss, expected = whole(moving, target, frozen)
    assert_close(layered_loss(moving, frozen, target)[1][:4], expected[:4])
    complete, gradients = layered_loss(moving, frozen, target, whole=True)
    assert complete == pytest.approx(loss, rel=1e-5)
    assert_close(gradients[:4], expected[:4])


@pytest.mark.parametrize("seed", range(3))
def test_layered_gradients_of_frozen_splats_where_requested(seed):
    moving, frozen, target = scene(seed)
    static, before = splats(400, seed), frozen.image.copy()
    where = np.concatenate([np.ones(30, bool), np.random.RandomState(seed).rand(400) < 0.05])
    everything = Splats.join(moving, static)
    expected, found = whole(everything, target)[1], layered_loss(everything, frozen, target, where=where)[1]
    assert_close([a[where] for a in found[:4]], [b[where] for b in expected[:4]])
    np.testing.assert_array_equal(frozen.image, before)


def test_layered_loss_after_removal_is_that_of_remaining_splats():
    moving, frozen, target = scene(0)
    rows = np.arange(400)
    rasterize.remove(frozen, rows[::7])
    others = splat.freeze(splats(400, 0).rows(rows[rows % 7 > 0]), WIDTH, HEIGHT)
    losses = [layered_loss(moving, held, target)[0] for held in (frozen, others)]
    assert losses[0] == pytest.approx(losses[1], abs=1e-6)


def test_layered_loss_differs_from_whole_image_by_constant():
    moving, frozen, target = scene(0)
    apart = []
    for brighter in (0.0, 0.1, 0.2):
        colors = moving.colors + np.float32(brighter)
        drawn = moving._replace(colors=colors)
        apart.append(whole(drawn, target, frozen)[0] - layered_loss(drawn, frozen, target)[0])
    assert apart[0] > 0
    np.testing.assert_allclose(apart, apart[0], atol=1e-6)


def test_targets_of_unknown_pixels_do_not_matter():
    moving, frozen, target = scene(0)
    unknown = np.zeros((HEIGHT, WIDTH), bool)
    unknown[:, : WIDTH // 3] = True
    other = np.where(unknown[..., None], np.uint8(7), target)
    (loss, found), (same, expected) = (layered_loss(moving, frozen, seen, unknown=unknown) for seen in (target, other))
    assert loss == same
    np.testing.assert_array_equal(found.colors, expected.colors)
    assert layered_loss(moving, frozen, target)[0] != loss


def test_layered_loss_restores_frozen_image():
    moving, frozen, target = scene(1)
    before = frozen.image.copy(), frozen.alpha.copy()
    layered_loss(moving, frozen, target)
    np.testing.assert_array_equal(frozen.image, before[0])
    np.testing.assert_array_equal(frozen.alpha, before[1])


def test_layered_loss_accepts_no_splats():
    moving, frozen, target = scene(2)
    nothing = moving.rows(np.arange(0))
    assert all(len(gradient) == 0 for gradient in layered_loss(nothing, frozen, target)[1])
