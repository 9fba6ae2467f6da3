"""Drawing moving splats among frozen splats gives the image and the gradients of drawing everything."""

import numpy as np
import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.kernels import cuda_backend as cuda
from splatreel.kernels import splat, twin
from splatreel.kernels.splat import Splats

WIDTH, HEIGHT = 100, 70


def splats(count, seed, spread=None):
    generator = torch.Generator().manual_seed(seed)
    middle, size = spread or ((WIDTH / 2, HEIGHT / 2), 1.2)
    means = torch.tensor(middle) + (torch.rand(count, 2, generator=generator) - 0.5) * size * torch.tensor(
        [WIDTH, HEIGHT]
    )
    root = torch.rand(count, 3, generator=generator) * 0.5 + torch.tensor([0.2, -0.25, 0.2])
    conics = torch.stack([root[:, 0] ** 2, 0.3 * root[:, 0] * root[:, 1], root[:, 2] ** 2], 1)
    colors = torch.rand(count, 3, generator=generator)
    opacities = torch.rand(count, generator=generator)
    depths = torch.rand(count, generator=generator) + 1
    return Splats(means, conics, colors, opacities, depths, torch.full((count,), 24, dtype=torch.int32))


def whole(moving, static):
    return splat.rasterize(Splats.join(moving, static), WIDTH, HEIGHT)


def among(moving, static):
    return splat.rasterize_among(moving, splat.freeze(static, WIDTH, HEIGHT))[:2]


def oracle(moving, static):
    return twin.rasterize_among(moving, static, WIDTH, HEIGHT)


def masked(moving, static):
    """Draw with the CUDA backend, with the twin in place of gsplat, which leaves masked tiles empty."""

    class TwinAsGsplat(cuda.CudaBackend):
        def rasterize(self, splats, width, height, absolute=None, tiles=None):
            image, alpha = twin.rasterize(splats, width, height)
            if tiles is None:
                return image, alpha
            drawn = torch.from_numpy(np.kron(tiles.numpy(), np.ones((16, 16), bool))[:HEIGHT, :WIDTH])
            return image * drawn[..., None], alpha * drawn

    backend = TwinAsGsplat()
    return backend.rasterize_among(moving, backend.freeze(static, WIDTH, HEIGHT))[:2]


def differentiated(draw, moving, static, target):
    leaves = Splats(*[value.clone().requires_grad_(value.is_floating_point()) for value in moving])
    image, alpha = draw(leaves, static)
    (splat.photometric_loss(image, target) + alpha.mean()).backward()
    return [image.detach(), alpha.detach(), *[leaf.grad for leaf in leaves[:4]]]


@pytest.mark.parametrize("faint", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_rasterize_among_equals_drawing_everything(seed, faint):
    static, moving = splats(400, seed), splats(30, seed + 100, ((30.0, 40.0), 0.3))
    static.depths[:20] = moving.depths[:20]  # at equal depth, moving splats are in front
    if not faint:
        static.opacities[:], moving.opacities[:] = 0.97, 0.9  # pixels fill up
    target = torch.rand(HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(seed))
    expected = differentiated(whole, moving, static, target)
    for draw in (among, oracle, masked) if faint else (among,):  # the twin rounds differently where pixels fill up
        for a, b in zip(expected, differentiated(draw, moving, static, target), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-3, atol=2e-6)


def test_rasterize_among_draws_only_touched_tiles():
    static, moving = splats(400, 0), splats(30, 100, ((30.0, 40.0), 0.3))
    frozen = splat.freeze(static, WIDTH, HEIGHT)
    image, alpha, tiles = splat.rasterize_among(moving, frozen)
    assert tiles.shape == (5, 7)
    assert 0.1 < tiles.float().mean() < 0.9
    kept = ~torch.from_numpy(np.kron(tiles.numpy(), np.ones((16, 16), bool))[:HEIGHT, :WIDTH])
    assert torch.equal(image[kept], frozen.image[kept])
    assert torch.equal(alpha[kept], frozen.alpha[kept])
    expected, _ = whole(moving, static)
    assert (frozen.image - expected).abs().max() > 0.1
    _, alone = splat.rasterize(moving, WIDTH, HEIGHT)
    assert not alone[kept].any()


def test_rasterize_among_without_splats_keeps_frozen_image():
    static, nothing = splats(50, 0), splats(0, 1)
    frozen = splat.freeze(static, WIDTH, HEIGHT)
    image, alpha, tiles = splat.rasterize_among(nothing, frozen)
    assert not tiles.any()
    assert torch.equal(image, frozen.image)
    assert torch.equal(alpha, frozen.alpha)


def test_rasterize_among_without_frozen_splats_equals_rasterize():
    moving, nothing = splats(50, 0), splats(0, 1)
    for a, b in zip(among(moving, nothing), whole(moving, nothing), strict=True):
        torch.testing.assert_close(a, b)


def test_freeze_rejects_nan():
    static, moving = splats(5, 0), splats(5, 1)
    frozen = splat.freeze(static, WIDTH, HEIGHT)
    moving.means2d[2, 1] = float("nan")
    with pytest.raises(GaussiansError, match="means2d holds 1 value"):
        splat.rasterize_among(moving, frozen)
    with pytest.raises(GaussiansError, match="means2d"):
        splat.freeze(moving, WIDTH, HEIGHT)


def test_tile_spans_cover_square_of_radius():
    spans = cuda.tile_spans(torch.tensor([[40.0, 20.0], [-9.0, 5.0]]), torch.tensor([5, 5]), WIDTH, HEIGHT)
    assert spans.tolist() == [[2, 2, 0, 1], [0, -1, 0, -1]]
    tiles = cuda.touched_tiles(spans, WIDTH, HEIGHT)
    assert tiles.shape == (5, 7)
    assert tiles.nonzero().tolist() == [[0, 2], [1, 2]]
    spans = torch.tensor([[0, 1, 0, 4], [2, 6, 1, 1], [0, 6, 0, 4], [0, -1, 0, -1]])
    assert cuda.touching(spans, tiles).tolist() == [1, 2]
