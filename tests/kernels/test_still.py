"""Drawing only the tiles that something moves in gives the picture and the gradients of drawing everything."""

import pytest
import torch

from splatreel.kernels import splat, twin

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
    return [means, conics, colors, opacities, depths, torch.full((count,), 12, dtype=torch.int32)]


def join(a, b):
    return [torch.cat(pair) for pair in zip(a, b, strict=True)]


def layered(moving, static):
    spans = splat.tile_spans(*[static[i] for i in (0, 1, 3, 5)], WIDTH, HEIGHT)
    image, alpha = splat.rasterize(*static, WIDTH, HEIGHT)
    tiles = splat.touched_tiles(splat.tile_spans(*[moving[i] for i in (0, 1, 3, 5)], WIDTH, HEIGHT), WIDTH, HEIGHT)
    near = splat.touching(spans, tiles)
    return join(moving, [value[near] for value in static]), splat.Still(tiles, image, alpha)


@pytest.mark.parametrize("seed", range(5))
def test_picture_and_gradients_equal_those_of_drawing_everything(seed):
    static, moving = splats(400, seed), splats(30, seed + 100, ((30.0, 40.0), 0.3))
    target = torch.rand(HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(seed))
    results = []
    for mode in ("whole", "layered", "twin"):
        leaves = [value.clone().requires_grad_(value.is_floating_point()) for value in moving]
        parts, still = layered(leaves, static) if mode != "whole" else (join(leaves, static), None)
        draw = twin.rasterize if mode == "twin" else splat.rasterize
        image, alpha = draw(*parts, WIDTH, HEIGHT, still)
        (splat.photometric_loss(image, target) + alpha.mean()).backward()
        results.append([image.detach(), alpha.detach(), *[leaf.grad for leaf in leaves[:4]]])
    if seed == 0:
        assert 0.1 < still.tiles.float().mean() < 0.9
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            torch.testing.assert_close(a, b, rtol=1e-3, atol=2e-6)


def test_without_moving_splats_the_picture_is_kept():
    static, nothing = splats(50, 0), splats(0, 1)
    parts, still = layered(nothing, static)
    image, alpha = splat.rasterize(*parts, WIDTH, HEIGHT, still)
    assert not still.tiles.any()
    assert len(parts[0]) == 0
    torch.testing.assert_close(image, still.image)
    torch.testing.assert_close(alpha, still.alpha)


def test_a_splat_touches_the_tiles_of_its_pixels():
    one = [
        torch.tensor([[40.0, 20.0]]),
        torch.tensor([[4.0, 0, 4.0]]),
        torch.tensor([0.9]),
        torch.tensor([5], dtype=torch.int32),
    ]
    spans = splat.tile_spans(*one, WIDTH, HEIGHT)
    assert spans.tolist() == [[2, 2, 1, 1]]
    tiles = splat.touched_tiles(spans, WIDTH, HEIGHT)
    assert tiles.shape == (5, 7)
    assert tiles.nonzero().tolist() == [[1, 2]]
    spans = torch.tensor([[0, 1, 0, 4], [2, 6, 1, 1], [0, 6, 0, 4], [0, -1, 0, -1]])
    assert splat.touching(spans, tiles).tolist() == [1, 2]


def test_tiles_are_those_of_the_twin():
    some, others = (
        splat.tile_spans(*[splats(count, seed)[i] for i in (0, 1, 3, 5)], WIDTH, HEIGHT)
        for count, seed in ((9, 1), (200, 2))
    )
    tiles = splat.touched_tiles(some, WIDTH, HEIGHT)
    assert 0 < int(tiles.sum()) < tiles.numel()
    assert torch.equal(tiles, twin.touched_tiles(some, WIDTH, HEIGHT))
    assert torch.equal(splat.touching(others, tiles), twin.touching(others, tiles))
