""""""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.importing.frames import open_frames
from splatreel.importing.moving_models import SpacetimeGaussians
from splatreel.scene.gaussians import C0


def arrays(frames: int = 3, count: int = 5) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    return {
        "means3D": rng.normal(size=(frames, count, 3)),
        "rgb_colors": rng.uniform(size=(frames, count, 3)),
        "unnorm_rotations": 3 * rng.normal(size=(frames, count, 4)),
        "logit_opacities": rng.normal(size=(count, 1)),
        "log_scales": rng.normal(size=(count, 3)),
        "seg_colors": rng.uniform(size=(count, 3)),
    }


def test_params_npz_points_match_their_parameters(tmp_path: Path) -> None:
    held = arrays()
    np.savez(tmp_path / "params.npz", **held)
    frames = open_frames(tmp_path)
    points = frames.read(1)
    assert len(frames) == 3
    assert frames.size == (tmp_path / "params.npz").stat().st_size
    np.testing.assert_allclose(points.means, held["means3D"][1], rtol=1e-6)
    np.testing.assert_allclose(0.5 + C0 * points.sh[:, 0], held["rgb_colors"][1], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(points.quats, axis=1), 1, rtol=1e-5)
    np.testing.assert_allclose(np.log(points.scales), held["log_scales"], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(1 / points.opacities - 1, np.exp(-held["logit_opacities"][:, 0]), rtol=1e-4)


def test_one_column_of_scales_makes_spheres(tmp_path: Path) -> None:
    held = arrays()
    held["log_scales"] = held["log_scales"][:, :1]
    np.savez(tmp_path / "params.npz", **held)
    points = open_frames(tmp_path).read(2)
    np.testing.assert_allclose(np.log(points.scales), np.repeat(held["log_scales"], 3, 1), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ["rgb_colors", "unnorm_rotations"])
def test_an_array_without_frames_is_constant(tmp_path: Path, name: str) -> None:
    held = arrays()
    for file, value in {"each.npz": np.repeat(held[name][:1], 3, 0), "once.npz": held[name][0]}.items():
        changed: dict[str, Any] = held | {name: value}
        np.savez(tmp_path / file, **changed)
    each, once = (open_frames(tmp_path / file) for file in ("each.npz", "once.npz"))
    for frame in range(3):
        np.testing.assert_array_equal(once.read(frame).sh, each.read(frame).sh)
        np.testing.assert_array_equal(once.read(frame).quats, each.read(frame).quats)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"log_scales": None}, "has no log_scales"),
        ({"log_scales": np.zeros((4, 3))}, "log_scales has the shape 4 x 3, expected N x 3 or N x 1"),
        ({"log_scales": np.zeros((5, 2))}, "log_scales has the shape"),
        ({"log_scales": np.zeros((4, 1))}, "log_scales has the shape"),
        (
            {"rgb_colors": np.zeros((4, 3))},
            "rgb_colors has the shape 4 x 3, expected T x N x 3 or N x 3 .*means3D: 3 x 5 x 3",
        ),
        ({"means3D": np.float64(1)}, "means3D has the shape of a single number"),
        ({"means3D": np.zeros((3, 5))}, "means3D has the shape"),
        ({"means3D": np.zeros((0, 5, 3))}, "has the shape 0 x 5 x 3, expected T x N x 3"),
    ],
)
def test_foreign_npz_is_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    held = {name: value for name, value in (arrays() | changes).items() if value is not None}
    np.savez(tmp_path / "params.npz", **held)
    with pytest.raises(GaussiansError, match=said):
        open_frames(tmp_path / "params.npz")


def test_damaged_npz_is_refused(tmp_path: Path) -> None:
    (tmp_path / "params.npz").write_bytes(b"PK\x03\x04 and nothing more")
    with pytest.raises(GaussiansError, match="is not an archive of arrays, or damaged"):
        open_frames(tmp_path)


def test_points_with_nan_are_dropped_and_counted(tmp_path: Path) -> None:
    held = arrays()
    held["means3D"][2, 1] = np.nan
    np.savez(tmp_path / "params.npz", **held)
    frames = open_frames(tmp_path)
    assert [len(frames.read(frame)) for frame in range(3)] == [5, 5, 4]
    assert "1 points with NaN" in frames.remarks.lines()[0]


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_frames_are_read_in_any_order(tmp_path: Path, save: Any) -> None:
    held = arrays(6) | {"rgb_colors": arrays(6)["rgb_colors"].astype(np.float32)}
    save(tmp_path / "params.npz", **held)
    frames = open_frames(tmp_path)
    for frame in (3, 5, 0, 3):
        np.testing.assert_allclose(frames.read(frame).means, held["means3D"][frame], rtol=1e-6)
        np.testing.assert_allclose(0.5 + C0 * frames.read(frame).sh[:, 0], held["rgb_colors"][frame], atol=1e-6)


def test_arrays_stored_by_column_are_refused(tmp_path: Path) -> None:
    held = arrays()
    held["means3D"] = np.asfortranarray(held["means3D"])
    np.savez(tmp_path / "params.npz", **held)
    with pytest.raises(GaussiansError, match="means3D is stored column by column"):
        open_frames(tmp_path)


N = 20
NAMES = ["x", "y", "z", "trbf_center", "trbf_scale", "nx", "ny", "nz", *(f"motion_{i}" for i in range(9))]
NAMES += [*(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3))]
NAMES += [*(f"rot_{i}" for i in range(4)), *(f"omega_{i}" for i in range(4))]


def write_model(folder: Path, extra: tuple[str, ...] = (), without: str = "") -> tuple[Path, dict[str, np.ndarray]]:
    """Write a model as its training does, with the settings two folders above. Return its file and its columns."""
    rng = np.random.default_rng(0)
    names = [name for name in (*NAMES, *extra) if name != without]
    table = np.zeros(N, [(name, "<f4") for name in names])
    for name in names:
        table[name] = rng.normal(size=N)
    for name in ("opacity", "trbf_scale"):
        table[name] = 2.0
    file = folder / "point_cloud" / "iteration_25000" / "point_cloud.ply"
    file.parent.mkdir(parents=True)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {N}"]
    header += [*(f"property float {name}" for name in names), "end_header", ""]
    file.write_bytes("\n".join(header).encode() + table.tobytes())
    (folder / "cfg_args").write_text("Namespace(sh_degree=3, duration=50, loader='colmap')")
    return file, {name: table[name].astype(float) for name in names}


def test_frames_follow_the_formulas_of_the_paper(tmp_path: Path) -> None:
    file, model = write_model(tmp_path / "model")
    frames = open_frames(tmp_path / "model")
    assert isinstance(frames, SpacetimeGaussians)
    assert len(frames) == len(open_frames(file)) == 50
    points, since = frames.read(20), 20 / 50 - model["trbf_center"]
    for axis, name in enumerate("xyz"):
        place = model[name] + sum(model[f"motion_{3 * k + axis}"] * since ** (k + 1) for k in range(3))
        np.testing.assert_allclose(points.means[:, axis], place, atol=1e-5)
    quats = np.stack([model[f"rot_{i}"] + since * model[f"omega_{i}"] for i in range(4)], 1)
    np.testing.assert_allclose(points.quats, quats / np.linalg.norm(quats, axis=1, keepdims=True), atol=1e-5)
    fade = np.exp(-((since / np.exp(model["trbf_scale"])) ** 2))
    np.testing.assert_allclose(points.opacities, fade / (1 + np.exp(-model["opacity"])), atol=1e-6)
    np.testing.assert_allclose(points.sh[:, 0, 1] * C0 + 0.5, model["f_dc_1"], atol=1e-5)
    np.testing.assert_allclose(points.scales[:, 2], np.exp(model["scale_2"]), rtol=1e-5)


def test_faded_points_are_left_out(tmp_path: Path) -> None:
    file, _ = write_model(tmp_path)
    data = file.read_bytes()
    table = np.frombuffer(data[-4 * N * len(NAMES) :], [(name, "<f4") for name in NAMES]).copy()
    table["trbf_scale"][:5], table["trbf_center"][:5] = -4, 0.9
    file.write_bytes(data[: -4 * N * len(NAMES)] + table.tobytes())
    assert len(open_frames(file).read(0)) == N - 5
    assert len(open_frames(file).read(45)) == N


def test_length_is_an_option_without_settings(tmp_path: Path) -> None:
    file, _ = write_model(tmp_path)
    (tmp_path / "cfg_args").unlink()
    with pytest.raises(GaussiansError, match="Give it with --length"):
        open_frames(file)
    assert len(open_frames(file, length=7)) == 7


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"extra": ("f_dc_3", "f_dc_4", "f_dc_5")}, "full model of SpacetimeGaussians"),
        ({"without": "motion_4"}, "missing motion_4"),
        ({"without": "omega_0"}, "missing omega_0"),
    ],
)
def test_other_models_are_refused(tmp_path: Path, how: dict, said: str) -> None:
    file, _ = write_model(tmp_path, **how)
    with pytest.raises(GaussiansError, match=said):
        open_frames(file)
