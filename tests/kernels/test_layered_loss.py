"""The layered loss equals the loss of the whole image up to a constant, and restores the frozen image."""

import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.kernels import splat
from splatreel.kernels.splat import Splats
from tests.kernels.test_freeze import HEIGHT, WIDTH, splats

GAIN, BACKGROUND = torch.tensor([0.9, 1.0, 1.1]), torch.tensor([0.1, 0.2, 0.3])


def scene(seed):
    generator = torch.Generator().manual_seed(seed)
    target = (torch.rand(HEIGHT, WIDTH, 3, generator=generator) * 255).to(torch.uint8)
    frozen = splat.freeze(splats(400, seed), WIDTH, HEIGHT)
    return splats(30, seed + 100, ((30.0, 40.0), 0.3)), frozen, target


def leaves(moving):
    return Splats(*[value.clone().requires_grad_(value.is_floating_point()) for value in moving])


def gradients(points):
    return [point.grad for point in points[:4]]


def whole(moving, frozen, target):
    """Return the loss of the whole image."""
    image, _, _ = splat.rasterize_among(moving, frozen)
    return splat.photometric_loss(image + BACKGROUND, target, 0.2, GAIN)


def assert_close(found, expected):
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6 * float(expected.abs().max()))
    assert expected.any()


@pytest.mark.parametrize("seed", range(3))
def test_layered_gradients_equal_those_of_whole_image(seed):
    moving, frozen, target = scene(seed)
    expected, found = leaves(moving), leaves(moving)
    (2 * whole(expected, frozen, target)).backward()
    (2 * splat.layered_loss(found, frozen, target, 0.2, GAIN, BACKGROUND)).backward()
    for a, b in zip(gradients(found), gradients(expected), strict=True):
        assert_close(a, b)


@pytest.mark.parametrize("seed", range(3))
def test_layered_gradients_of_frozen_splats_where_requested(seed):
    moving, frozen, target = scene(seed)
    static, before = splats(400, seed), frozen.image.clone()
    asked = torch.rand(400, generator=torch.Generator().manual_seed(seed)) < 0.05
    where = torch.cat([torch.ones(30, dtype=torch.bool), asked])
    everything = Splats.join(moving, static)
    expected, found = leaves(everything), leaves(everything)
    image, _ = splat.rasterize(expected, WIDTH, HEIGHT)
    splat.photometric_loss(image + BACKGROUND, target, 0.2, GAIN).backward()
    splat.layered_loss(found, frozen, target, 0.2, GAIN, BACKGROUND, where).backward()
    for a, b in zip(gradients(found), gradients(expected), strict=True):
        assert_close(a[where], b[where])
    assert torch.equal(frozen.image, before)


def test_remove_draws_remaining_frozen_splats():
    static = splats(400, 0)
    frozen, rows = splat.freeze(static, WIDTH, HEIGHT), torch.arange(400)
    for gone in (rows[::7], rows[3:40:2]):
        frozen = splat.remove(frozen, gone)
        rows = rows[~torch.isin(rows, gone)]
        others = splat.freeze(static.rows(rows), WIDTH, HEIGHT)
        torch.testing.assert_close(frozen.image, others.image, rtol=0, atol=1e-6)
        torch.testing.assert_close(frozen.alpha, others.alpha, rtol=0, atol=1e-6)
        moving, _, target = scene(0)
        found = [splat.layered_loss(moving, held, target) for held in (frozen, others)]
        assert float(found[0]) == pytest.approx(float(found[1]), abs=1e-6)
    assert len(rows) < 340


def test_layered_loss_differs_from_whole_image_by_constant():
    moving, frozen, target = scene(0)
    apart = []
    for brighter in (0.0, 0.1, 0.2):
        moving = moving._replace(colors=moving.colors + brighter)
        apart.append(whole(moving, frozen, target) - splat.layered_loss(moving, frozen, target, 0.2, GAIN, BACKGROUND))
    assert float(apart[0]) > 0
    torch.testing.assert_close(torch.stack(apart), apart[0].expand(3), rtol=0, atol=1e-6)


def test_layered_loss_restores_frozen_image():
    moving, frozen, target = scene(1)
    before = frozen.image.clone(), frozen.alpha.clone()
    splat.layered_loss(moving, frozen, target)
    assert torch.equal(frozen.image, before[0])
    assert torch.equal(frozen.alpha, before[1])
    moving.colors[3, 1] = torch.nan
    with pytest.raises(GaussiansError, match="colors"):
        splat.layered_loss(moving, frozen, target)
    assert torch.equal(frozen.image, before[0])


def test_layered_loss_accepts_no_splats():
    moving, frozen, target = scene(2)
    nothing = leaves(Splats(*[value[:0] for value in moving]))
    splat.layered_loss(nothing, frozen, target).backward()
    assert all(gradient.shape[0] == 0 for gradient in gradients(nothing))
