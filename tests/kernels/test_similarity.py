"""The photometric loss against the twin's convolutions and known answers."""

import pytest
import torch

from splatreel.errors import GaussiansError
from splatreel.kernels import splat, twin
from tests.kernels.compare import assert_parity


def pictures(height, width, seed=0):
    generator = torch.Generator().manual_seed(seed)
    target = torch.rand(height, width, 3, generator=generator)
    return (target + 0.1 * torch.randn(height, width, 3, generator=generator)).clamp(0, 1), target


@pytest.mark.parametrize("lambda_dssim", [0.0, 0.2, 1.0])
@pytest.mark.parametrize(("height", "width"), [(29, 37), (1, 1), (4, 40), (40, 3), (12, 11)])
def test_parity(lambda_dssim, height, width):
    image, target = pictures(height, width)
    assert_parity(
        lambda x: splat.photometric_loss(x, target, lambda_dssim),
        lambda x: twin.photometric_loss(x, target.double(), lambda_dssim),
        [image],
        2e-5,
    )


def test_equal_pictures_have_no_loss():
    _, target = pictures(20, 20)
    image = target.clone().requires_grad_()
    loss = splat.photometric_loss(image, target)
    assert abs(loss.item()) < 1e-6
    loss.backward()
    assert image.grad is not None
    assert float(image.grad.abs().max()) < 1e-6


def test_l1_alone_is_the_mean_difference():
    image, target = torch.full((8, 8, 3), 0.75), torch.full((8, 8, 3), 0.5)
    assert float(splat.photometric_loss(image, target, 0.0)) == pytest.approx(0.25)


def test_bytes_are_0_to_255():
    image, target = pictures(20, 20)
    bytes_ = (target * 255).round().to(torch.uint8)
    assert float(splat.photometric_loss(image, bytes_)) == float(splat.photometric_loss(image, bytes_.float() / 255))


def test_the_gradient_scales_with_the_loss():
    image, target = pictures(20, 20)
    once, twice = image.clone().requires_grad_(), image.clone().requires_grad_()
    splat.photometric_loss(once, target).backward()
    (2 * splat.photometric_loss(twice, target)).backward()
    assert once.grad is not None
    assert twice.grad is not None
    torch.testing.assert_close(2 * once.grad, twice.grad)


def test_different_sizes_are_refused():
    with pytest.raises(GaussiansError, match=r"\(4, 5, 3\)"):
        splat.photometric_loss(torch.zeros(4, 5, 3), torch.zeros(5, 4, 3))
