"""The photometric loss: known answers."""

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.kernels.similarity import loss_and_gradient
from tests.kernels.cases import images, uniform
from tests.kernels.compare import floats


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
