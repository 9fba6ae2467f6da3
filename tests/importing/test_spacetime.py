"""Models of SpacetimeGaussians, evaluated by the formulas of the paper."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.importing.recognition import open_frames
from splatreel.importing.spacetime import SpacetimeGaussians
from splatreel.scene.gaussians import C0

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
