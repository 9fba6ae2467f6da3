"""Drawing during training."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.kernels import splat
from splatreel.kernels.project import BLUR, FINE_BLUR
from splatreel.kernels.splat import Splats
from splatreel.method.init.layout import measure
from splatreel.method.train.render import StaticCache, View, contributions, deformed, draw, relative_distances
from splatreel.method.train.trainable_points import to_params
from splatreel.method.train.training_images import halved
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import Gaussians
from tests.method.captures import blots
from tests.method.scenes import random_gaussians, ring

NEAR = 0.1
VIEWS = [View.of(camera) for camera in ring(3, width=96, height=64)]
WALL = blots(300, [-3, -2, 0.9], [3, 2, 1.0], 0.14, 0)
THING = blots(30, [-0.9, -0.6, -0.4], [-0.2, 0.6, 0.2], 0.06, 1)


def moving(view: View, thing: Gaussians = THING) -> Splats:
    return deformed(to_params(thing), None, None, view, NEAR)


def static_cache(points: Gaussians = WALL) -> StaticCache:
    return StaticCache(points, VIEWS, NEAR)


def gradients(splats: Splats, image: np.ndarray, alpha: np.ndarray, frozen=None):
    """Return the gradients of a sum of the image with random weights."""
    weights = np.random.default_rng(0).random(image.shape, np.float32)
    return splat.rasterize_gradient(splats, image.shape[1], image.shape[0], image, alpha, weights, frozen=frozen)


@pytest.mark.parametrize("camera", range(3))
def test_drawing_among_static_points_matches_drawing_of_all(camera: int) -> None:
    """Image, alpha and gradients of moving points agree."""
    view, seen, static = VIEWS[camera], moving(VIEWS[camera]), static_cache().view(camera)
    image, alpha = draw(seen, view, static)
    together = Splats.join(seen, static.splats)
    whole, whole_alpha = draw(together, view)
    np.testing.assert_allclose(image, whole, atol=1e-5)
    np.testing.assert_allclose(alpha, whole_alpha, atol=1e-5)
    found, expected = gradients(seen, image, alpha, static.frozen), gradients(together, whole, whole_alpha)
    for name in ("means2d", "conics", "opacities", "colors"):
        one, all_of_them = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(one, all_of_them[: len(THING)], atol=1e-3, rtol=1e-3, err_msg=name)


def test_views_with_antialiasing_have_less_blur() -> None:
    [camera] = ring(1)
    assert View.of(camera).pinhole(NEAR).blur == BLUR
    fine = View.of(camera, antialias=True)
    assert fine.pinhole(NEAR).blur == FINE_BLUR
    assert fine.pinhole(NEAR) is fine.pinhole(NEAR)
    assert fine.pinhole(0.2).near == 0.2
    assert fine.halved().pinhole(NEAR).width == fine.width // 2


@pytest.mark.parametrize("antialias", [False, True])
def test_deformed_points_are_those_of_the_parts(antialias: bool) -> None:
    """Projection and colors agree with those of points that are moved before."""
    points = random_gaussians(80)
    view = replace(VIEWS[0], antialias=antialias, background=np.array([0.1, 0.2, 0.3], np.float32))
    dx = np.tile(np.array([0.1, -0.2, 0.3], np.float32), (80, 1))
    shade = np.tile(np.array([0.1, 0.2, -0.3, 0.5], np.float32), (80, 1))
    still = np.tile(np.array([2.0, 0, 0, 0], np.float32), (80, 1))
    found = deformed(to_params(points), (dx, still), shade, view, NEAR)
    logits = np.log(points.opacities / (1 - points.opacities)) + 0.5
    sh = points.sh.copy()
    sh[:, 0] += shade[:, :3]
    moved = Gaussians(points.means + dx, points.quats, points.scales, 1 / (1 + np.exp(-logits)), sh)
    expected = deformed(to_params(moved), None, None, view, NEAR)
    # Colors of points are seen from where they were at the keyframe, or are; both agree to the change of direction.
    for name in ("means2d", "conics", "opacities", "depths", "colors"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-3, atol=1e-4, err_msg=name)
    plain = splat.project(moved.means, moved.quats, moved.scales, view.viewmat, view.K, 96, 64, NEAR, antialias)
    np.testing.assert_allclose(found.means2d, plain.means2d, rtol=1e-4, atol=1e-3)
    opaque = splat.antialiased(moved.opacities, plain.conics) if antialias else moved.opacities
    seen = plain.radii > 0
    np.testing.assert_allclose(found.opacities[seen], opaque[seen], rtol=1e-3)


def test_deformed_points_must_be_finite() -> None:
    params = to_params(THING)
    params["means"][3, 1] = np.nan
    with pytest.raises(GaussiansError, match="means holds 1 values"):
        deformed(params, None, None, VIEWS[0], NEAR)


def test_clearance_hides_static_points_only() -> None:
    camera = ring(3, width=96, height=64)[0]
    layout = measure([camera], WALL.means, NEAR)
    depths = WALL.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    clearance = Clearance((0.0, 0.0, 0.0), float(np.median(depths) / camera.viewmat[2, 3]))
    view = View.of(camera, layout=replace(layout, clearance=clearance))
    near, far = WALL[depths < np.median(depths)], WALL[depths > np.median(depths)]
    seen = StaticCache(WALL, [view], NEAR).view(0)
    assert 0 < len(seen.index) <= len(far)
    expected = StaticCache(far, VIEWS, NEAR).view(0)
    found, alone = (draw(moving(view, near), view, static)[0] for static in (seen, expected))
    np.testing.assert_allclose(found, alone, atol=1e-6)
    assert np.abs(found - draw(moving(view, near[:0]), view, expected)[0]).max() > 0.1


@pytest.mark.parametrize("among", [True, False])
def test_background_matches_alpha_blending(among: bool) -> None:
    """The image and the gradients to the splats equal those of a background blended by alpha."""
    color = np.array([0.3, 0.9, 0.1], np.float32)
    plain, view = VIEWS[1], replace(VIEWS[1], background=color)
    seen, black = moving(view), moving(plain)
    static, behind = (StaticCache(WALL[:40], [one] * 3, NEAR).view(1) for one in (view, plain))
    if not among:
        seen, black = Splats.join(seen, static.splats), Splats.join(black, behind.splats)
    image, _ = draw(seen, view, static if among else None)
    over_black, alpha = draw(black, plain, behind if among else None)
    expected = over_black + (1 - alpha[..., None]) * color
    assert (np.abs(image - color).max(-1) < 1e-6).any(), "somewhere nothing is"
    np.testing.assert_allclose(image, expected, atol=1e-5)

    weights = np.random.default_rng(0).random(image.shape, np.float32)
    frozen = (static.frozen, behind.frozen) if among else (None, None)
    found = splat.rasterize_gradient(seen, 96, 64, image - color, alpha, weights, frozen=frozen[0])
    to_alpha = -(weights * color).sum(-1)
    blended = splat.rasterize_gradient(black, 96, 64, over_black, alpha, weights, to_alpha, frozen[1])
    for one, other in zip(found[:4], blended[:4], strict=True):
        np.testing.assert_allclose(one, other, atol=2e-3, rtol=1e-3)


def test_draw_without_static_points() -> None:
    seen = moving(VIEWS[0])
    image, alpha = draw(seen, VIEWS[0])
    before_nothing, _ = draw(seen, VIEWS[0], static_cache(Gaussians.empty(0)).view(0))
    np.testing.assert_allclose(image, before_nothing, atol=1e-6)
    assert (alpha == 0).any()


@pytest.mark.parametrize("drawn_before", [True, False])
def test_static_view_contains_living_points_only(drawn_before: bool) -> None:
    alive = WALL.means[:, 0] < 0.3
    behind = static_cache()
    if drawn_before:
        assert len(behind.view(1).index) > alive.sum() // 2
    behind.set_alive(alive)
    static, expected = behind.view(1), static_cache(WALL[alive]).view(1)
    assert alive[static.index].all()
    np.testing.assert_array_equal(np.flatnonzero(alive)[expected.index], static.index)
    np.testing.assert_allclose(static.frozen.image, expected.frozen.image, atol=1e-6)
    np.testing.assert_allclose(static.frozen.alpha, expected.frozen.alpha, atol=1e-6)
    assert len(static.index) == len(static.splats.means2d)
    assert np.abs(static_cache().view(1).frozen.image - static.frozen.image).max() > 0.1


def test_set_alive_copies_mask() -> None:
    behind, alive = static_cache(), np.ones(len(WALL), bool)
    behind.set_alive(alive)
    alive[0] = False
    assert behind.alive.all()


def test_static_cache_projects_once_per_view() -> None:
    behind = static_cache()
    first = behind.view(2)
    assert behind.view(2) is first
    behind.set_alive(np.ones(len(WALL), bool))
    assert behind.view(2) is first, "nothing died"


def test_contributions_equal_visible_pixels() -> None:
    """Only the visible part of a splat counts. One splat is in front of a wall, the other behind it."""
    wall = Gaussians(WALL.means, WALL.quats, WALL.scales, np.full(len(WALL), 0.999), WALL.sh)
    view, static = VIEWS[0], static_cache(wall).view(0)
    one = THING[:1]
    before = moving(view, one)
    alone = draw(before, view)[1].sum()
    behind = moving(view, Gaussians(one.means + np.array([0, 0, 3]), one.quats, one.scales, one.opacities, one.sh))
    assert alone > 1
    np.testing.assert_allclose(contributions(before, view, static), [alone], atol=1e-3, rtol=1e-3)
    through = (draw(behind, view, static)[1] - static.frozen.alpha).sum()
    assert through < 0.5 * alone
    np.testing.assert_allclose(contributions(behind, view, static), [through], atol=1e-3, rtol=1e-3)


def test_relative_distances_are_those_to_the_nearest_view() -> None:
    centers = np.stack([view.center for view in VIEWS])
    means = np.concatenate([centers + np.float32(0.5), [[0, 0, 60]], [[0, 0, 900]]]).astype(np.float32)
    found = relative_distances(means, VIEWS, 4.0, 100.0)
    away = np.linalg.norm(means[3] - centers, axis=1).min() / 4
    np.testing.assert_allclose(found, [1, 1, 1, away, 100], rtol=1e-5)
    assert found.dtype == np.float32


def test_halved_images_match_halved_views() -> None:
    views = [View.of(camera, antialias=True) for camera in ring(2, width=97, height=65)]
    seen = StaticCache(WALL, views, NEAR)
    images = np.stack([seen.view(k).frozen.image for k in range(2)])
    small = halved((images.clip(0, 1) * 255).round().astype(np.uint8))
    seen.set_views([view.halved() for view in views])
    again = np.stack([seen.view(k).frozen.image for k in range(2)])
    assert small.shape == again.shape == (2, 32, 48, 3)
    assert np.abs(small / 255 - again.clip(0, 1)).mean() < 0.01
