"""Drawing during training."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from splatreel.kernels.projected import Splats
from splatreel.method.init.layout import measure
from splatreel.method.train.render import StaticCache, View, contributions, draw, splats
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import halved
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import Gaussians
from tests.method.captures import blots
from tests.method.scenes import ring

CPU, NEAR = torch.device("cpu"), 0.1
VIEWS = [View.of(camera, CPU) for camera in ring(3, width=96, height=64)]
WALL = blots(300, [-3, -2, 0.9], [3, 2, 1.0], 0.14, 0)
THING = blots(30, [-0.9, -0.6, -0.4], [-0.2, 0.6, 0.2], 0.06, 1)


def moving(view: View, thing: Gaussians = THING) -> tuple[TrainablePoints, Splats]:
    p = TrainablePoints.from_gaussians(thing, default_rates(4.0), CPU)
    return p, splats(p.means, p.quats, p.scales, p.opacities, p.sh, view, NEAR)


def static_cache(points: Gaussians = WALL) -> StaticCache:
    return StaticCache(points, VIEWS, NEAR, CPU)


@pytest.mark.parametrize("camera", range(3))
def test_layered_drawing_matches_whole_drawing(camera: int) -> None:
    """Image, alpha and gradients of moving points agree; only whole drawing gives gradients to static points."""
    results = []
    for layered in (True, False):
        points, seen = moving(VIEWS[camera])
        drawing = draw(seen, VIEWS[camera], static_cache().view(camera), layered=layered)
        weights = torch.rand(drawing.image.shape, generator=torch.Generator().manual_seed(0))
        (drawing.image * weights).sum().backward()
        assert drawing.moving == len(THING)
        assert drawing.means2d.grad is not None
        results.append((drawing, drawing.means2d.grad, points))
    (part, part_grad, part_points), (whole, whole_grad, whole_points) = results
    torch.testing.assert_close(part.image, whole.image, atol=1e-5, rtol=0)
    torch.testing.assert_close(part.alpha, whole.alpha, atol=1e-5, rtol=0)
    torch.testing.assert_close(part_grad, whole_grad[: len(THING)], atol=1e-4, rtol=1e-3)
    assert whole_grad[len(THING) :].any()
    for name, tensor in part_points.params.items():
        torch.testing.assert_close(tensor.grad, whole_points.params[name].grad, atol=1e-3, rtol=1e-3)
    assert part.index is None
    assert part.tiles is not None
    assert 0 < part.tiles.float().mean() < 1, "static points far from what moves is not drawn again"
    assert whole.index is not None
    assert len(whole_grad) == len(THING) + len(whole.index)
    assert whole.tiles is None


def test_clearance_hides_static_points_only() -> None:
    camera = ring(3, width=96, height=64)[0]
    layout = measure([camera], WALL.means, NEAR)
    depths = WALL.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    clearance = Clearance((0.0, 0.0, 0.0), float(np.median(depths) / camera.viewmat[2, 3]))
    view = View.of(camera, CPU, layout=replace(layout, clearance=clearance))
    near, far = WALL[depths < np.median(depths)], WALL[depths > np.median(depths)]
    seen = StaticCache(WALL, [view], NEAR, CPU).view(0)
    assert 0 < len(seen.index) <= len(far)
    expected = StaticCache(far, VIEWS, NEAR, CPU).view(0)
    drawn = [draw(moving(view, near)[1], view, static).image for static in (seen, expected)]
    torch.testing.assert_close(*drawn, atol=1e-6, rtol=0)
    assert (drawn[0] - draw(moving(view, near[:0])[1], view, expected).image).abs().max() > 0.1


@pytest.mark.parametrize("layered", [True, False])
def test_background_matches_alpha_blending(layered: bool) -> None:
    """Image and gradients equal those of a background blended by alpha."""
    color = torch.tensor([0.3, 0.9, 0.1])
    plain = VIEWS[1]
    view = replace(plain, background=color)
    results = []
    for seen_by in (view, plain):
        points, seen = moving(seen_by)
        static = StaticCache(WALL[:40], [seen_by] * 3, NEAR, CPU).view(1)
        drawing = draw(seen, seen_by, static, layered=layered)
        image = drawing.image if seen_by is view else drawing.image + (1 - drawing.alpha[..., None]) * color
        weights = torch.rand(image.shape, generator=torch.Generator().manual_seed(0))
        (image * weights).sum().backward()
        results.append((image.detach(), points))
    assert ((results[0][0] - color).abs().amax(-1) < 1e-6).any(), "somewhere nothing is"
    torch.testing.assert_close(results[0][0], results[1][0], atol=1e-5, rtol=0)
    for name, tensor in results[0][1].params.items():
        torch.testing.assert_close(tensor.grad, results[1][1].params[name].grad, atol=1e-3, rtol=1e-3)


def test_draw_without_static_points() -> None:
    _, seen = moving(VIEWS[0])
    alone, before_nothing = draw(seen, VIEWS[0]), draw(seen, VIEWS[0], static_cache(Gaussians.empty(0)).view(0))
    assert alone.index is None
    torch.testing.assert_close(alone.image, before_nothing.image, atol=1e-6, rtol=0)
    assert (alone.alpha == 0).any()


@pytest.mark.parametrize("drawn_before", [True, False])
def test_static_view_contains_living_points_only(drawn_before: bool) -> None:
    alive = torch.from_numpy(WALL.means[:, 0] < 0.3)
    behind = static_cache()
    if drawn_before:
        assert len(behind.view(1).index) > int(alive.sum()) // 2
    behind.set_alive(alive)
    static, expected = behind.view(1), static_cache(WALL[alive.numpy()]).view(1)
    assert bool(alive[static.index].all())
    np.testing.assert_array_equal(torch.nonzero(alive)[:, 0][expected.index], static.index)
    torch.testing.assert_close(static.frozen.image, expected.frozen.image, atol=1e-6, rtol=0)
    torch.testing.assert_close(static.frozen.alpha, expected.frozen.alpha, atol=1e-6, rtol=0)
    assert len(static.index) == len(static.splats.means2d)
    assert (static_cache().view(1).frozen.image - static.frozen.image).abs().max() > 0.1


def test_set_alive_copies_mask() -> None:
    behind, alive = static_cache(), torch.ones(len(WALL), dtype=torch.bool)
    behind.set_alive(alive)
    alive[0] = False
    assert bool(behind.alive.all())


def test_static_cache_projects_once_per_view() -> None:
    behind = static_cache()
    first = behind.view(2)
    assert behind.view(2) is first
    behind.set_alive(torch.ones(len(WALL), dtype=torch.bool))
    assert behind.view(2) is first, "nothing died"


def test_contributions_equal_visible_pixels() -> None:
    """Only the visible part of a splat counts. One splat is in front of a wall, the other behind it."""
    wall = Gaussians(WALL.means, WALL.quats, WALL.scales, np.full(len(WALL), 0.999), WALL.sh)
    view, static = VIEWS[0], static_cache(wall).view(0)
    one = THING[:1]
    _, before = moving(view, one)
    alone = float(draw(before, view).alpha.sum().detach())
    _, behind = moving(view, Gaussians(one.means + np.array([0, 0, 3]), one.quats, one.scales, one.opacities, one.sh))
    assert alone > 1
    torch.testing.assert_close(contributions(before, view, static), torch.tensor([alone]), atol=1e-3, rtol=1e-3)
    through = (draw(behind, view, static).alpha - static.frozen.alpha).sum().detach()
    assert through < 0.5 * alone
    torch.testing.assert_close(contributions(behind, view, static), through[None], atol=1e-3, rtol=1e-3)


def test_halved_images_match_halved_views() -> None:
    views = [View.of(camera, CPU, antialias=True) for camera in ring(2, width=97, height=65)]
    seen = StaticCache(WALL, views, NEAR, CPU)
    images = torch.stack([seen.view(k).frozen.image for k in range(2)])
    small = halved((images.clamp(0, 1) * 255).round().to(torch.uint8))
    seen.set_views([view.halved() for view in views])
    again = torch.stack([seen.view(k).frozen.image for k in range(2)])
    assert small.shape == again.shape == (2, 32, 48, 3)
    assert (small.float() / 255 - again.clamp(0, 1)).abs().mean() < 0.01
