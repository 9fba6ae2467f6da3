"""The photometric loss compared with the twin's convolutions and with known answers."""

import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.kernels import splat, twin
from tests.kernels.compare import assert_parity


def make_images(height, width, seed=0):
    generator = torch.Generator().manual_seed(seed)
    target = torch.rand(height, width, 3, generator=generator)
    return (target + 0.1 * torch.randn(height, width, 3, generator=generator)).clamp(0, 1), target


@pytest.mark.parametrize("lambda_dssim", [0.0, 0.2, 1.0])
@pytest.mark.parametrize(("height", "width"), [(29, 37), (1, 1), (4, 40), (40, 3), (12, 11)])
def test_photometric_loss_equals_twin(lambda_dssim, height, width):
    image, target = make_images(height, width)
    assert_parity(
        lambda x: splat.photometric_loss(x, target, lambda_dssim),
        lambda x: twin.photometric_loss(x, target.double(), lambda_dssim),
        [image],
        2e-5,
    )


def test_photometric_loss_of_equal_images_is_zero():
    _, target = make_images(20, 20)
    image = target.clone().requires_grad_()
    loss = splat.photometric_loss(image, target)
    assert abs(loss.item()) < 1e-6
    loss.backward()
    assert image.grad is not None
    assert float(image.grad.abs().max()) < 1e-6


def test_photometric_loss_without_ssim_is_mean_difference():
    image, target = torch.full((8, 8, 3), 0.75), torch.full((8, 8, 3), 0.5)
    assert float(splat.photometric_loss(image, target, 0.0)) == pytest.approx(0.25)


def test_photometric_loss_accepts_uint8_target():
    image, target = make_images(20, 20)
    bytes_ = (target * 255).round().to(torch.uint8)
    expected = float(splat.photometric_loss(image, bytes_.float() / 255))
    assert float(splat.photometric_loss(image, bytes_)) == pytest.approx(expected, rel=1e-6)


def test_photometric_gradient_scales_with_loss():
    image, target = make_images(20, 20)
    once, twice = image.clone().requires_grad_(), image.clone().requires_grad_()
    splat.photometric_loss(once, target).backward()
    (2 * splat.photometric_loss(twice, target)).backward()
    assert once.grad is not None
    assert twice.grad is not None
    torch.testing.assert_close(2 * once.grad, twice.grad)


@pytest.mark.parametrize("as_bytes", [True, False])
@pytest.mark.parametrize(("height", "width"), [(29, 37), (40, 130)])
def test_photometric_loss_equals_twin_with_gain(height, width, as_bytes):
    image, target = make_images(height, width)
    target = (target * 255).round().to(torch.uint8) if as_bytes else target
    assert_parity(
        lambda x, gain: splat.photometric_loss(x, target, 0.2, gain),
        lambda x, gain: twin.photometric_loss(x, target if as_bytes else target.double(), 0.2, gain),
        [image, torch.tensor([0.9, 1.0, 1.2])],
        2e-5,
    )


@pytest.mark.parametrize("seed", range(4))
def test_photometric_gradient_of_tiles_equals_whole_image(seed):
    """If only some tiles change, the loss changes as much as that of the whole image. The window reaches into neighboring tiles."""
    generator = torch.Generator().manual_seed(seed)
    height, width, gain = 90, 350, torch.tensor([0.9, 1.0, 1.1])
    tiles = torch.rand(6, 22, generator=generator) < (0.05, 0.3, 0.7, 1.0)[seed]
    inside = tiles.repeat_interleave(16, 0).repeat_interleave(16, 1)[:height, :width, None]
    (image, target), (other, _) = make_images(height, width, seed), make_images(height, width, seed + 50)
    losses = []
    for drawn in (image, torch.where(inside, other, image)):
        leaf, same = drawn.clone().requires_grad_(), drawn.clone().requires_grad_()
        whole, part = (
            splat.photometric_loss(leaf, target, 0.2, gain),
            splat.photometric_loss(same, target, 0.2, gain, tiles),
        )
        (3 * whole).backward()
        (3 * part).backward()
        assert leaf.grad is not None
        assert same.grad is not None
        torch.testing.assert_close(same.grad, leaf.grad * inside, rtol=1e-5, atol=1e-9)
        losses.append((whole.item(), part.item()))
    (before, part_before), (after, part_after) = losses
    assert before != after
    assert part_after - part_before == pytest.approx(after - before, abs=2e-7)


def test_photometric_gradient_is_zero_without_tiles():
    image, target = make_images(20, 40)
    leaf = image.requires_grad_()
    splat.photometric_loss(leaf, target, tiles=torch.zeros(2, 3, dtype=torch.bool)).backward()
    assert leaf.grad is not None
    assert not leaf.grad.any()


def test_photometric_loss_rejects_tiles_with_trainable_gain():
    image, target = make_images(20, 40)
    with pytest.raises(GaussiansError, match="pass no tiles"):
        splat.photometric_loss(image, target, 0.2, torch.ones(3).requires_grad_(), torch.ones(2, 3, dtype=torch.bool))


def test_photometric_loss_rejects_different_sizes():
    with pytest.raises(GaussiansError, match=r"\(4, 5, 3\)"):
        splat.photometric_loss(torch.zeros(4, 5, 3), torch.zeros(5, 4, 3))
