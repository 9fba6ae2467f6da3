"""3DGS PLY files: round trip, the layout that viewers expect, damage."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.errors import GaussiansError
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.ply import read_ply, write_ply
from tests.golden import random_gaussians


def points(count=20, degree=3):
    return random_gaussians(np.random.default_rng(0), count, degree, (0, 0, 0))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_ply_round_trips(tmp_path, degree):
    gaussians = points(degree=degree)
    write_ply(tmp_path / "a.ply", gaussians)
    again = read_ply(tmp_path / "a.ply")
    for name in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(again, name), getattr(gaussians, name), rtol=1e-5, atol=1e-6, err_msg=name)
    assert [file.name for file in tmp_path.iterdir()] == ["a.ply"]


def test_ply_layout_is_that_of_3dgs(tmp_path):
    """One point written by hand: logit, logarithm, and f_rest with all of red first."""
    sh = np.arange(12, dtype=np.float32).reshape(1, 4, 3)
    one = Gaussians(np.array([[1, 2, 3]]), np.array([[1, 0, 0, 0]]), np.array([[1, np.e, 1]]), np.array([0.5]), sh)
    write_ply(tmp_path / "a.ply", one)
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    names = [line.split()[-1].decode() for line in header.split(b"\n") if line.startswith(b"property float")]
    xyz = ["x", "y", "z", "nx", "ny", "nz"]
    colors = [f"f_dc_{i}" for i in range(3)] + [f"f_rest_{i}" for i in range(9)]
    assert names == [*xyz, *colors, "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    values = [1, 2, 3, 0, 0, 0, 0, 1, 2, 3, 6, 9, 4, 7, 10, 5, 8, 11, 0, 0, 1, 0, 1, 0, 0, 0]
    np.testing.assert_allclose(np.frombuffer(body, "<f4"), values, atol=1e-6)


def test_ply_keeps_extreme_values_finite(tmp_path):
    gaussians = points(2, 0)
    hard = Gaussians(gaussians.means, gaussians.quats, np.zeros((2, 3)), np.array([0.0, 1.0]), gaussians.sh)
    write_ply(tmp_path / "a.ply", hard)
    np.testing.assert_allclose(read_ply(tmp_path / "a.ply").opacities, [0, 1], atol=1e-5)


def test_ply_without_points(tmp_path):
    write_ply(tmp_path / "a.ply", Gaussians.empty(0))
    assert len(read_ply(tmp_path / "a.ply")) == 0


def test_reads_other_types_and_extra_properties(tmp_path):
    """Editors write doubles, colors and no normals."""
    names = [
        "x",
        "y",
        "z",
        *(f"{n}_{i}" for n, k in (("f_dc", 3), ("scale", 3), ("rot", 4)) for i in range(k)),
        "opacity",
    ]
    record = np.zeros(1, [(n, "<f8") for n in names] + [("red", "u1")])
    record["x"], record["rot_0"] = 7, 2
    header = "".join(f"property double {n}\n" for n in names) + "property uchar red\n"
    text = f"ply\nformat binary_little_endian 1.0\ncomment by hand\nelement vertex 1\n{header}end_header\n"
    (tmp_path / "a.ply").write_bytes(text.encode() + record.tobytes())
    gaussians = read_ply(tmp_path / "a.ply")
    assert gaussians.means.tolist() == [[7, 0, 0]]
    assert gaussians.quats.tolist() == [[1, 0, 0, 0]]
    assert gaussians.opacities.tolist() == [0.5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "not a binary"),
        (b"ply\nformat ascii 1.0\nend_header\n", "not a binary"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float x\nend_header\n", "missing y, z"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty list int x\nend_header\n", "property"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex -9\nend_header\n", "claims"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex 1" + b"0" * 40 + b"\nend_header\n", "claims"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 9999999999\nproperty float x\nend_header\n",
            "ends after",
        ),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty int x\nproperty int x\nend_header\n",
            "twice",
        ),
    ],
)
def test_ply_refuses_other_files(tmp_path, text, message):
    (tmp_path / "a.ply").write_bytes(text)
    with pytest.raises(GaussiansError, match=message) as error:
        read_ply(tmp_path / "a.ply")
    assert "a.ply" in str(error.value)


def test_ply_names_unusable_paths(tmp_path):
    with pytest.raises(GaussiansError, match="cannot be read"):
        read_ply(tmp_path / "none.ply")
    with pytest.raises(GaussiansError, match="could not be written"):
        write_ply(tmp_path / "none" / "a.ply", points())


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_damaged_ply_raises_gaussians_error_or_decodes(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("ply") / "a.ply"
    write_ply(path, points(3, 1))
    damaged = bytearray(path.read_bytes())
    for at in data.draw(st.lists(st.integers(0, len(damaged) - 1), max_size=3)):
        damaged[at] = data.draw(st.integers(0, 255))
    del damaged[data.draw(st.integers(0, 2 * len(damaged))) :]
    path.write_bytes(damaged)
    with contextlib.suppress(GaussiansError):
        read_ply(path)


def test_ply_refuses_elements_before_points(tmp_path):
    write_ply(tmp_path / "a.ply", points(2, 0))
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "b.ply").write_bytes(data.replace(b"element vertex", b"element face 0\nelement vertex"))
    with pytest.raises(GaussiansError, match=r"b\.ply: its points .element vertex. do not come first"):
        read_ply(tmp_path / "b.ply")
