"""Columns that differ from those of 3DGS: converted with a remark, or refused by name."""

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.formats.splat_columns import Encoding, Remarks, encoding_of, gaussians_of
from splatreel.scene.gaussians import C0, Gaussians

N = 60


def columns() -> dict[str, np.ndarray]:
    """Return columns as 3DGS writes them: opacities 0.05 to 0.95, scales 0.01 to 0.1."""
    rng = np.random.default_rng(0)
    opacities, scales = rng.uniform(0.05, 0.95, N), rng.uniform(0.01, 0.1, (N, 3))
    found = {name: rng.normal(size=N) for name in ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2")}
    found |= {f"rot_{i}": rng.normal(size=N) for i in range(4)}
    found |= {f"scale_{i}": np.log(scales[:, i]) for i in range(3)}
    return found | {"opacity": np.log(opacities / (1 - opacities))}


def convert(given: dict[str, np.ndarray], encoding: Encoding | None = None) -> tuple[Gaussians, str]:
    remarks = Remarks()
    points = gaussians_of(given, "a.ply", None, remarks, encoding)
    return points, "\n".join(remarks.lines())


def test_plain_columns_need_no_remark() -> None:
    points, said = convert(columns())
    assert (len(points), said) == (N, "")


@pytest.mark.parametrize("which", [("opacity",), ("scale",), ("opacity", "scale")])
def test_values_without_log_and_logit_are_recognized(which: tuple[str, ...]) -> None:
    expected, _ = convert(columns())
    given = columns()
    if "opacity" in which:
        given["opacity"] = expected.opacities.astype(float)
    if "scale" in which:
        given |= {f"scale_{i}": expected.scales[:, i].astype(float) for i in range(3)}
    points, said = convert(given)
    np.testing.assert_allclose(points.opacities, expected.opacities, atol=1e-6)
    np.testing.assert_allclose(points.scales, expected.scales, rtol=1e-5)
    assert ("not as logits" in said, "not as logarithms" in said) == ("opacity" in which, "scale" in which)


@pytest.mark.parametrize("value", [-4.0, 0.0, 0.7, 2.2])
def test_constant_logits_stay_logits(value: float) -> None:
    points, said = convert(columns() | {"opacity": np.full(N, value)})
    np.testing.assert_allclose(points.opacities, 1 / (1 + np.exp(-value)), rtol=1e-5)
    assert ("read as the logit" in said) == (0 < value < 1)


def test_constant_one_is_opaque() -> None:
    points, said = convert(columns() | {"opacity": np.ones(N)})
    assert (points.opacities == 1).all()
    assert "not as logits" in said


def test_scales_of_a_scene_in_millimeters_stay_logarithms() -> None:
    given = columns() | {f"scale_{i}": np.random.default_rng(i).uniform(0.1, 3, N) for i in range(3)}
    assert encoding_of(given) == Encoding()


def test_few_points_are_judged_by_opacities_and_scales_together() -> None:
    few = {name: column[:3] for name, column in columns().items()} | {"opacity": np.array([0.1, 0.5, 0.9])}
    assert encoding_of(few) == Encoding()
    linear = few | {f"scale_{i}": np.array([0.01, 0.02, 0.03]) for i in range(3)}
    assert encoding_of(linear) == Encoding(logit=False, logarithm=False)


@pytest.mark.parametrize(
    ("colors", "most"),
    [
        (np.array([0, 51, 255], np.uint8), 255),
        (np.array([0, 13107, 65535], np.uint16), 65535),
        ([0, 0.2, 1], 1),
        ([0, 51.0, 255], 255),
    ],
)
def test_colors_of_any_type(colors: np.ndarray, most: float) -> None:
    column = np.resize(np.asarray(colors), N)
    given = {name: value for name, value in columns().items() if not name.startswith("f_dc")}
    points, said = convert(given | dict.fromkeys(("red", "green", "blue"), column))
    np.testing.assert_allclose(points.sh[:, 0, 1] * C0 + 0.5, column / most, atol=1e-6)
    assert "red, green, blue" in said


def test_bytes_of_opacity() -> None:
    points, _ = convert(columns() | {"opacity": np.full(N, 51, np.uint8)})
    np.testing.assert_allclose(points.opacities, 0.2, rtol=1e-6)


@pytest.mark.parametrize(("left", "said"), [(1, "One scale"), (2, "2DGS")])
def test_fewer_scales(left: int, said: str) -> None:
    given = {name: value for name, value in columns().items() if name not in ("scale_2", "scale_1")[: 3 - left]}
    points, remarks = convert(given)
    assert said in remarks
    if left == 1:
        assert (points.scales == points.scales[:, :1]).all()
    else:
        np.testing.assert_allclose(points.scales[:, 2], 0.01 * points.scales[:, :2].min(1), rtol=1e-5)


def test_absent_rotations_and_opacities() -> None:
    bare = {name: value for name, value in columns().items() if not name.startswith(("rot", "opacity"))}
    points, said = convert(bare)
    assert (points.quats == [1, 0, 0, 0]).all()
    assert (points.opacities == 1).all()
    assert "No rotation" in said
    assert "No opacity" in said


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_harmonics_of_every_degree(degree: int) -> None:
    count = (degree + 1) ** 2 - 1
    rest = {f"f_rest_{i}": np.full(N, float(i)) for i in range(3 * count)}
    points, said = convert(columns() | rest)
    kept = min(count, 15)
    assert points.sh.shape == (N, kept + 1, 3)
    assert points.sh[0, 1:].tolist() == [[i, count + i, 2 * count + i] for i in range(kept)]
    assert ("degree 4 was cut" in said) == (degree == 4)


def test_filter_of_mip_splatting_is_applied() -> None:
    plain, _ = convert(columns())
    points, said = convert(columns() | {"filter_3D": np.full(N, 0.05)})
    np.testing.assert_allclose(points.scales**2, plain.scales**2 + 0.0025, rtol=1e-4)
    volume = np.prod(plain.scales / points.scales, axis=1)
    np.testing.assert_allclose(points.opacities, plain.opacities * volume, rtol=1e-4)
    assert "filter_3D" in said


def test_points_with_nan_are_dropped_and_counted() -> None:
    given = columns()
    given["x"][3], given["rot_2"][7], given["f_dc_1"][7], given["scale_0"][9] = np.nan, np.nan, np.inf, np.nan
    given["opacity"][11] = np.inf
    points, said = convert(given)
    assert len(points) == N - 3
    assert points.opacities[11 - 3] == 1
    assert "3 points with NaN" in said


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        ({"trbf_center": 0, "motion_0": 0, "omega_0": 0}, "trbf_center, motion_0, omega_0 of SpacetimeGaussians"),
        ({"f_t_0": 0}, "f_t_0 of SpacetimeGaussians"),
        ({"t": 0, "scale_t": 0}, "t, scale_t of 4D Gaussian Splatting"),
        ({"mu_t": 0, "t_scale": 0}, "mu_t, t_scale of 4D Gaussian Splatting"),
        ({"rot_r_0": 0, "scale_t_0": 0}, "rot_r_0, scale_t_0 of 4D Gaussian Splatting"),
        ({"fea_0": 0, "fea_1": 0}, "fea_0, fea_1 of SC-GS"),
        ({"embedding_0": 0}, "embedding_0 of E-D3DGS"),
        ({"xyz_disp_0": 0}, "xyz_disp_0 of Ex4DGS"),
        ({"motion_xyz_0_1": 0, "motion_opacity_c_0": 0}, "motion_xyz_0_1, motion_opacity_c_0 of Ex4DGS"),
        ({"omega_0": 0, "control_x_0": 0, "current_control_num": 0}, "control_x_0, current_control_num of SplineGS"),
        ({"beta": 0}, "beta of Beta Splatting .* no Gaussians"),
        ({"sb_params_0": 0, "sb_params_1": 0}, "sb_params_0, sb_params_1 of Beta Splatting"),
        ({"f_offset_0": 0, "f_anchor_feat_0": 0}, "f_offset_0, f_anchor_feat_0 of Scaffold-GS"),
        ({"vx": 0, "vy": 0}, "vx, vy of a method"),
        ({"velocity_0": 0, "acceleration_0": 0}, "velocity_0, acceleration_0 of a method"),
        ({"dynamic_logit": 0, "duration": 0}, "dynamic_logit, duration of a method"),
        ({"delta_x_t0": 0}, "delta_x_t0 of a method"),
        ({"f_rest_0": 0}, "has 1 f_rest columns"),
    ],
)
def test_foreign_columns_are_refused_by_name(extra: dict[str, float], said: str) -> None:
    with pytest.raises(GaussiansError, match=said):
        convert(columns() | {name: np.full(N, value) for name, value in extra.items()})


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        ("x", "missing x"),
        ("scale", "point cloud without sizes"),
        ("f_dc", "no color"),
        ("rot_3", "of the four numbers"),
    ],
)
def test_missing_columns_are_named(missing: str, said: str) -> None:
    given = {name: value for name, value in columns().items() if not name.startswith(missing)}
    with pytest.raises(GaussiansError, match=said):
        convert(given)


def test_columns_without_a_meaning_here_are_ignored_with_a_remark() -> None:
    _, said = convert(columns() | {"nx": np.zeros(N), "label": np.zeros(N), "red": np.zeros(N)})
    assert said.startswith(
        "Unknown columns were ignored, also if the program that wrote them draws points by them: label (a.ply)"
    )


@pytest.mark.parametrize("most", [100, 255])
def test_opacities_that_are_no_logits_are_refused(most: float) -> None:
    given = columns()
    given["opacity"] = np.random.default_rng(1).uniform(0, most, N)
    with pytest.raises(GaussiansError, match="neither logits nor 0 to 1"):
        convert(given)
    given["opacity"] = np.full(N, 100.0)
    assert np.all(convert(given)[0].opacities == 1), "logits of opaque points"


def test_rotations_of_zeros_are_counted() -> None:
    given = columns()
    for name in ("rot_0", "rot_1", "rot_2", "rot_3"):
        given[name][:7] = 0
    points, said = convert(given)
    assert "7 points with a rotation of zeros" in said
    assert points.quats[:7].tolist() == [[1, 0, 0, 0]] * 7
