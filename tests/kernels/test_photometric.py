"""The layered loss equals the loss of the whole image up to a constant, and restores the frozen image."""

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.kernels import photometric, rasterize, splat
from splatreel.kernels.photometric import loss_and_gradient
from splatreel.kernels.rasterize import Gradients
from splatreel.kernels.splat import Splats
from tests.kernels.cases import images, uniform
from tests.kernels.compare import floats
from tests.kernels.test_freeze import HEIGHT, WIDTH, splats


def test_loss_of_equal_images_is_zero():
    _, target = images(20, 20)
    found = loss_and_gradient(target, target, 0.2)
    assert abs(found.loss) < 1e-6
    assert np.abs(found.d_image).max() < 1e-6


def test_loss_without_ssim_is_mean_difference():
    image, target = np.full((8, 8, 3), 0.75, np.float32), np.full((8, 8, 3), 0.5, np.float32)
    assert loss_and_gradient(image, target, 0.0).loss == pytest.approx(0.25)


def test_loss_of_a_target_of_bytes_is_that_of_their_values():
    image, target = images(20, 20)
    bytes_ = np.rint(target * 255).astype(np.uint8)
    expected = loss_and_gradient(image, bytes_.astype(np.float32) / 255, 0.2).loss
    assert loss_and_gradient(image, bytes_, 0.2).loss == pytest.approx(expected, rel=1e-6)


def test_background_and_gain_are_those_of_the_drawing():
    image, target = images(20, 30)
    gain, background = floats([0.9, 1.0, 1.1]), floats([0.1, 0.0, -0.1])
    found = loss_and_gradient(image, target, 0.2, gain, background=background)
    plain = loss_and_gradient((image + background) * gain, target, 0.2)
    assert found.loss == pytest.approx(plain.loss, rel=1e-6)
    np.testing.assert_allclose(found.d_image, plain.d_image * gain, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_gradient_of_tiles_equals_whole_image(seed):
    """If only some tiles change, the loss changes as much as that of the whole image. The window reaches into neighboring tiles."""
    height, width, gain = 90, 350, floats([0.9, 1.0, 1.1])
    tiles = uniform(6, 22, seed=seed) < (0.05, 0.3, 0.7, 1.0)[seed]
    inside = np.kron(tiles, np.ones((16, 16), bool))[:height, :width, None]
    (image, target), (other, _) = images(height, width, seed), images(height, width, seed + 50)
    losses = []
    for drawn in (image, np.where(inside, other, image)):
        whole, part = (loss_and_gradient(drawn, target, 0.2, gain, some) for some in (None, tiles))
        np.testing.assert_allclose(part.d_image, whole.d_image * inside, rtol=1e-5, atol=1e-9)
        losses.append((whole.loss, part.loss))
    (before, part_before), (after, part_after) = losses
    assert before != after
    assert part_after - part_before == pytest.approx(after - before, abs=2e-7)


def test_gradient_is_zero_without_tiles():
    assert not loss_and_gradient(*images(20, 40), 0.2, tiles=np.zeros((2, 3), bool)).d_image.any()


def test_loss_rejects_different_sizes():
    with pytest.raises(GaussiansError, match=r"\(4, 5, 3\)"):
        loss_and_gradient(np.zeros((4, 5, 3), np.float32), np.zeros((5, 4, 3), np.float32), 0.2)


GAIN, BACKGROUND = floats([0.9, 1.0, 1.1]), floats([0.1, 0.2, 0.3])


def scene(seed):
    target = np.random.RandomState(seed).randint(256, size=(HEIGHT, WIDTH, 3)).astype(np.uint8)
    frozen = splat.freeze(splats(400, seed), WIDTH, HEIGHT)
    return splats(30, seed + 100, ((30.0, 40.0), 0.3)), frozen, target


def whole(drawn, target, frozen=None) -> tuple[float, Gradients]:
    """Return the loss of the whole image and its gradients."""
    image, alpha = splat.rasterize(drawn, WIDTH, HEIGHT, frozen)
    found = photometric.loss_and_gradient(image, target, 0.2, GAIN, background=BACKGROUND)
    return found.loss, splat.rasterize_gradient(drawn, WIDTH, HEIGHT, image, alpha, found.d_image, frozen=frozen)


def layered_loss(drawn, frozen, target, **options) -> tuple[float, Gradients]:
    bins = splat.bin(drawn, WIDTH, HEIGHT)
    return photometric.loss_and_gradient_among(bins, drawn.colors, frozen, target, 0.2, GAIN, BACKGROUND, **options)


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
