"""Sets of Gaussians."""

from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.kernels.image import render_image
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians, turn_between, turn_upright, turned
from tests.golden import camera, random_gaussians


def points(count=6, degree=1):
    return random_gaussians(np.random.default_rng(0), count, degree, (0, 0, 0))


def arrays(gaussians):
    return {name: getattr(gaussians, name) for name in ("means", "quats", "scales", "opacities", "sh")}


def test_arrays_become_float32():
    assert {array.dtype for array in arrays(points()).values()} == {np.dtype(np.float32)}


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "sh"])
def test_wrong_shapes_are_refused(name):
    changed: dict[str, Any] = arrays(points()) | {name: np.zeros((6, 5, 2))}
    with pytest.raises(GaussiansError):
        Gaussians(**changed)


def test_five_bands_are_refused():
    changed: dict[str, Any] = arrays(points()) | {"sh": np.zeros((6, 5, 3))}
    with pytest.raises(GaussiansError, match="5 coefficients"):
        Gaussians(**changed)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_check_finite_names_the_field(value):
    gaussians = points()
    gaussians.check_finite()
    gaussians.scales[1, 2] = value
    with pytest.raises(GaussiansError, match="here: scales holds 1 values"):
        gaussians.check_finite("here")


def test_moved_applies_offsets():
    """x + dx, q * dq (paper 4.2): the offset rotates the point about its own axes first."""
    gaussians = points()
    dx = np.full((6, 3), 0.5)
    dq = np.tile([2.0, 0, 0, 2.0], (6, 1))  # not unit: a quarter turn about z
    moved = gaussians.moved(dx, dq)
    np.testing.assert_allclose(moved.means, gaussians.means + 0.5)
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    expected = rotations.to_matrix(gaussians.quats) @ quarter
    np.testing.assert_allclose(rotations.to_matrix(moved.quats), expected, atol=1e-5)
    np.testing.assert_array_equal(moved.opacities, gaussians.opacities)


@pytest.mark.parametrize("weight", [0.0, 0.3, 0.5, 1.0])
def test_complementary_fades_absorb_like_one_set(weight):
    gaussians = points()
    through = (1 - gaussians.faded(weight).opacities) * (1 - gaussians.faded(1 - weight).opacities)
    np.testing.assert_allclose(through, 1 - gaussians.opacities, atol=1e-4)


def test_indexing_selects_points():
    gaussians = points()
    mask = np.arange(6) % 2 == 0
    np.testing.assert_array_equal(gaussians[mask].means, gaussians.means[::2])
    np.testing.assert_array_equal(gaussians[np.array([3, 1])].sh, gaussians.sh[[3, 1]])
    assert len(gaussians[:0]) == 0


def test_concatenate_pads_sh():
    joined = Gaussians.concatenate([points(2, 0), points(3, 2), Gaussians.empty(1)])
    assert (len(joined), joined.sh_degree) == (5, 2)
    np.testing.assert_array_equal(joined.sh[:2, 1:], 0)
    np.testing.assert_array_equal(joined.sh[2:], points(3, 2).sh)


def test_empty_has_no_points():
    assert (len(Gaussians.empty()), Gaussians.empty(2).sh_degree) == (0, 2)


@pytest.mark.parametrize("degree", [0, 3])
def test_brightened_multiplies_every_color(degree):
    gaussians, factor = points(degree=degree), np.array([0.3, 1, 2.5], np.float32)
    view = camera("a", 0.5)
    np.testing.assert_allclose(
        render_image(gaussians.brightened(factor), view), render_image(gaussians, view) * factor, atol=1e-4
    )


CENTER = (1.0, -2.0, 3.0)


@pytest.mark.parametrize(
    ("start", "end"),
    [
        ((0, -1, 0), (0, 1, 0)),
        ((0, 1, 0), (0, 1, 0)),
        ((1, 0, 0), (-1, 0, 0)),
        ((0, 0, 2), (0, -1, 0)),
        ((0.3, -0.5, 0.1), (1, 2, 3)),
    ],
)
def test_direction_is_turned_to_another(start: tuple[float, ...], end: tuple[float, ...]) -> None:
    found = rotations.to_matrix(turn_between(np.array(start), np.array(end))) @ np.array(start)
    np.testing.assert_allclose(found / np.linalg.norm(start), np.array(end) / np.linalg.norm(end), atol=1e-9)


def test_opposite_directions_are_half_a_turn_about_x() -> None:
    assert turn_between(np.array([0, -1, 0]), np.array([0, 1, 0])).tolist() == [0, 1, 0, 0]


def color(sh: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return colors [N, 3] as 3DGS computes them, without clipping."""
    x, y, z = direction
    basis = [0.28209479177387814, *(0.4886025119029199 * np.array([-y, z, -x]))]
    two = np.array(
        [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396]
    )
    basis += (two * [x * y, y * z, 2 * z * z - x * x - y * y, x * z, x * x - y * y]).tolist()
    three = [-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154]
    three += [-0.4570457994644658, 1.445305721320277, -0.5900435899266435]
    last = [y * (3 * x * x - y * y), x * y * z, y * (4 * z * z - x * x - y * y)]
    last += [z * (2 * z * z - 3 * x * x - 3 * y * y), x * (4 * z * z - x * x - y * y), z * (x * x - y * y)]
    basis += (np.array(three) * [*last, x * (x * x - 3 * y * y)]).tolist()
    return np.einsum("k,nkc->nc", np.array(basis)[: sh.shape[1]], sh) + 0.5


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("quat", [(0, 1, 0, 0), (0.8, -0.1, 0.5, 0.3)])
def test_scene_looks_the_same_from_a_turned_viewpoint(degree: int, quat: tuple[float, ...]) -> None:
    points = random_gaussians(np.random.default_rng(degree), 30, degree, CENTER)
    turn = np.array(quat) / np.linalg.norm(quat)
    matrix, found = rotations.to_matrix(turn), turned(points, turn)
    np.testing.assert_allclose(found.means, points.means @ matrix.T, atol=1e-5)
    axes, before = rotations.to_matrix(found.quats), rotations.to_matrix(points.quats)
    np.testing.assert_allclose(axes, matrix @ before, atol=1e-5)
    for direction in np.eye(3)[[0, 1, 2]]:
        np.testing.assert_allclose(color(found.sh, matrix @ direction), color(points.sh, direction), atol=1e-4)


def test_slightly_tilted_scenes_keep_the_same_side_in_front() -> None:
    up = np.array([0.01, -1, -0.008])
    down, upward = (turn_upright(up, np.array([0.0, sign, 0])) for sign in (-1, 1))
    half = rotations.multiply(np.array([0.0, 1, 0, 0]), down)
    np.testing.assert_allclose(np.abs(half @ upward), 1, atol=1e-9)
    np.testing.assert_allclose(rotations.to_matrix(upward) @ up / np.linalg.norm(up), [0, 1, 0], atol=1e-9)
