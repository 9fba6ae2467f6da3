"""The loss of splats among frozen ones equals that of the whole picture, up to a constant, and leaves the frozen picture as it was."""

import pytest
import torch

from splatreel.errors import GaussiansError
from splatreel.kernels import splat
from tests.kernels.test_freeze import HEIGHT, WIDTH, splats

GAIN, BACKGROUND = torch.tensor([0.9, 1.0, 1.1]), torch.tensor([0.1, 0.2, 0.3])
TILES = -(-HEIGHT // 16), -(-WIDTH // 16)


def scene(seed):
    generator = torch.Generator().manual_seed(seed)
    target = (torch.rand(HEIGHT, WIDTH, 3, generator=generator) * 255).to(torch.uint8)
    frozen = splat.freeze(*splats(400, seed), WIDTH, HEIGHT)
    return splats(30, seed + 100, ((30.0, 40.0), 0.3)), frozen, target


def leaves(moving):
    return [value.clone().requires_grad_(value.is_floating_point()) for value in moving]


def gradients(points):
    return [point.grad for point in points[:4]]


def whole(moving, frozen, target, wanted=None):
    """The loss of the whole picture, with gradients only from the wanted tiles."""
    image, _, tiles = splat.rasterize_among(*moving, frozen)
    if wanted is not None:
        pixels = wanted.repeat_interleave(16, 0).repeat_interleave(16, 1)[:HEIGHT, :WIDTH, None]
        image = torch.where(pixels, image, image.detach())
    return splat.photometric_loss(image + BACKGROUND, target, 0.2, GAIN), tiles


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("some", [False, True])
def test_gradients_equal_those_of_the_whole_picture(seed, some):
    moving, frozen, target = scene(seed)
    wanted = torch.rand(TILES, generator=torch.Generator().manual_seed(seed)) < 0.5 if some else None
    expected, found = leaves(moving), leaves(moving)
    (2 * whole(expected, frozen, target, wanted)[0]).backward()
    (2 * splat.layered_loss(*found, frozen, target, 0.2, GAIN, BACKGROUND, wanted)).backward()
    for a, b in zip(gradients(found), gradients(expected), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6 * float(b.abs().max()))
        assert b.any()


def test_the_loss_differs_from_that_of_the_whole_picture_by_a_constant():
    moving, frozen, target = scene(0)
    apart = []
    for brighter in (0.0, 0.1, 0.2):
        moving[2] = moving[2] + brighter
        apart.append(
            whole(moving, frozen, target)[0] - splat.layered_loss(*moving, frozen, target, 0.2, GAIN, BACKGROUND)
        )
    assert float(apart[0]) > 0
    torch.testing.assert_close(torch.stack(apart), apart[0].expand(3), rtol=0, atol=1e-6)


def test_the_frozen_picture_stays_as_it_is():
    moving, frozen, target = scene(1)
    before = frozen.image.clone(), frozen.alpha.clone()
    splat.layered_loss(*moving, frozen, target)
    assert torch.equal(frozen.image, before[0])
    assert torch.equal(frozen.alpha, before[1])
    moving[2][3, 1] = torch.nan
    with pytest.raises(GaussiansError, match="colors"):
        splat.layered_loss(*moving, frozen, target)
    assert torch.equal(frozen.image, before[0])


def test_without_splats_there_is_no_gradient():
    moving, frozen, target = scene(2)
    nothing = leaves([value[:0] for value in moving])
    splat.layered_loss(*nothing, frozen, target).backward()
    assert all(gradient.shape[0] == 0 for gradient in gradients(nothing))
