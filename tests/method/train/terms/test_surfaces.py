"""Terms of surfaces: mist before surfaces fades, and planes are free."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from splatreel.kernels.splat import Splats
from splatreel.method.train.render import View, deformed
from splatreel.method.train.terms.surfaces import MAX_SEPARATION, Roughness, Spread, roughness, spread
from splatreel.method.train.terms.term import Depths, Term
from splatreel.method.train.trainable_points import to_params
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.method.scenes import look_at


def to_opacities(term: Term[Any], depths: Depths, image: np.ndarray | None = None) -> np.ndarray:
    """Return the gradient [N] of a term to the opacities of splats."""
    term.add_to_drawing(cast(Any, SimpleNamespace(depths=depths, target=image, unit=3.0, near=0.1)), 1.0)
    return depths.to_splats()[2]


def splats_of(means: np.ndarray, scales: np.ndarray, opacities: np.ndarray, view: View, near: float) -> Splats:
    count = len(means)
    quats, sh = np.tile([1.0, 0, 0, 0], (count, 1)), np.zeros((count, 1, 3))
    params = to_params(Gaussians(means, quats, np.repeat(scales[:, None], 3, 1), np.full(count, 0.5), sh))
    return deformed(params, None, None, view, near)._replace(opacities=np.array(opacities, np.float32))


def seen(depths: list[float], opacities: list[float], scale: float = 1.0) -> Depths:
    """Return the depths of splats that each fill the view of one camera."""
    camera = look_at([0, 0, -4], width=32, height=24)
    center = camera.center * scale
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = camera.viewmat[:3, :3], -camera.viewmat[:3, :3] @ center
    view = View.of(Camera("a", pose, camera.K, 32, 24))
    means = np.stack([center + scale * depth * camera.forward for depth in depths])
    sizes = scale * 20 * np.array(depths)
    return Depths.of(splats_of(means, sizes, np.array(opacities), view, 0.1 * scale), view, 0.1 * scale)


def test_spread_of_one_depth_is_zero() -> None:
    assert spread(seen([3.0, 3.0], [0.6, 0.9])) < 1e-4


@pytest.mark.parametrize("scale", [1.0, 1000.0])
@pytest.mark.parametrize("behind", [2.5, 4.0])
def test_spread_grows_with_distance_to_surface(scale: float, behind: float) -> None:
    depths = seen([2.0, behind], [0.2, 0.9], scale)
    first, second, apart = 0.2, 0.8 * 0.9, np.log(behind / 2)
    share = second / (first + second)
    assert spread(depths) == pytest.approx(first * share**2 * min(apart, MAX_SEPARATION) ** 2, rel=0.02)
    slopes = to_opacities(Spread("spread"), depths)
    assert slopes[0] > 0, "the floater shall fade"
    assert slopes[0] > slopes[1]


@pytest.mark.parametrize("mist", [0.1, 0.4, 0.6, 0.9])
def test_spread_fades_mist_of_any_thickness(mist: float) -> None:
    """The symmetric variance of depths would make mist grow if it fills more than half of a pixel."""
    slopes = to_opacities(Spread("spread"), seen([1.0, 4.0], [mist, 0.95]))
    assert slopes[0] > 0
    assert slopes[1] <= 0, "the surface stays"


@pytest.mark.parametrize(
    ("places", "shown"),
    [([0.2, 1.0, 1.1, 3.0, 40.0], [0.3] * 5), ([2.0, 3.0], [0.0, 0.0]), ([2.0, 2.0000001], [0.5, 0.5])],
)
def test_spread_is_finite_for_many_layers_and_none(places: list[float], shown: list[float]) -> None:
    depths = seen(places, shown)
    assert np.isfinite(spread(depths))
    assert np.isfinite(to_opacities(Spread("spread"), depths)).all()


def corrugated(amplitude: float, slope: float = 0.0) -> tuple[Splats, View]:
    """Return a wall of small splats that is tilted by `slope`; every other column is displaced."""
    camera = look_at([0, 0, -4], width=48, height=32)
    columns, rows = np.meshgrid(np.arange(1, 48, 2.0), np.arange(1, 32, 2.0))
    depth = 1 / (0.3 + slope * columns + amplitude * (np.arange(columns.shape[1]) % 2))
    local = np.stack([(columns - 24) / camera.K[0, 0], (rows - 16) / camera.K[1, 1], np.ones_like(depth)], -1)
    means = (local * depth[..., None]).reshape(-1, 3) @ camera.viewmat[:3, :3] + camera.center
    view = View.of(camera)
    return splats_of(means, depth.ravel() / camera.K[0, 0], np.full(len(means), 0.9), view, 0.1), view


def rough(amplitude: float, slope: float = 0.0, edges: bool = False) -> float:
    points, view = corrugated(amplitude, slope)
    image = np.zeros((view.height, view.width, 3), np.uint8)
    if edges:
        image[:, 2::4] = image[:, 3::4] = 255
    return roughness(Depths.of(points, view, 0.1), image, 30.0)


def test_roughness_is_zero_for_tilted_planes() -> None:
    assert rough(0.0) < 1e-4
    leaning, bent = rough(0.0, 0.004), rough(0.01)
    assert leaning < 0.3 * bent, "all that bends is its steps from splat to splat"
    assert rough(0.02) > 1.5 * bent


def test_roughness_is_smaller_at_image_edges() -> None:
    assert rough(0.02, edges=True) < 0.2 * rough(0.02)


def test_roughness_fades_plate_in_front_of_plain_wall() -> None:
    points, view = corrugated(0.0)
    count = len(points.opacities)
    near = np.zeros(count, bool)
    near[count // 2 + 8 : count // 2 + 14] = True  # a few in the middle of a row, at half the distance
    lifted = points._replace(depths=np.where(near, points.depths / 2, points.depths))
    image = np.zeros((32, 48, 3), np.uint8)
    slopes = to_opacities(Roughness("roughness"), Depths.of(lifted, view, 0.1), image)
    assert slopes[near].sum() > 0
    assert slopes[near].mean() > 5 * slopes[~near].mean()
