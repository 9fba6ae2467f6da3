"""3DGS PLY files: round trip, the layout that viewers expect, damage."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base.errors import GaussiansError, StorageError
from splatreel.formats.ply import read_ply, write_ply
from splatreel.formats.splat_columns import Remarks
from splatreel.scene.gaussians import Gaussians
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
        (b"", "not a PLY"),
        (b"ply\nformat ascii 1.0\nend_header\n", "has no points"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float x\nend_header\n", "missing y, z"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty list int x\nend_header\n", "a list"),
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
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match=r"a\.ply: could not write"):
        write_ply(tmp_path / "file" / "a.ply", points())


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


def table_of(gaussians):
    """Return the rows of a written file, without the header, and the names of its columns."""
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3))]
    names += [f"f_rest_{i}" for i in range(3 * (gaussians.sh.shape[1] - 1))]
    return [*names, "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]


def rewrite(path, order="<", line_end="\n", before=b"", element="", text=False, drop=(), **columns):
    """Write `points(40, 1)` in another way: byte order, line ends, another element first, text, other columns."""
    write_ply(path, points(40, 1))
    body = path.read_bytes().split(b"end_header\n")[1]
    names = table_of(points(40, 1))
    plain = np.frombuffer(body, [(name, "<f4") for name in names])
    kinds = [(name, np.dtype(order + "f4")) for name in names if name not in drop]
    kinds += [(name, np.dtype(order + np.asarray(column).dtype.str[1:])) for name, column in columns.items()]
    table = np.zeros(40, kinds)
    for name, _ in kinds:
        table[name] = columns[name] if name in columns else plain[name]
    words = {"f": "float", "d": "double", "B": "uchar", "H": "ushort"}
    style = "ascii" if text else "binary_little_endian" if order == "<" else "binary_big_endian"
    lines = ["ply", f"format {style} 1.0", "comment by hand", *filter(None, [element]), "element vertex 40"]
    lines += [f"property {words[kind.char]} {name}" for name, kind in kinds]
    rows = "".join(" ".join(repr(value.item()) for value in row) + line_end for row in table).encode()
    header = line_end.join([*lines, "end_header", ""]).encode()
    path.write_bytes(header + before + (rows if text else table.tobytes()))
    return path


LISTS = "element face 2\nproperty list uchar int vertex_indices"


@pytest.mark.parametrize(
    "how",
    [
        {"order": ">"},
        {"line_end": "\r\n"},
        {"line_end": "\r"},
        {"text": True},
        {"text": True, "line_end": "\r\n"},
        {"element": "element time 2\nproperty float t", "before": b"\0" * 8},
        {"element": "element empty 0\nproperty uchar a"},
        {"element": LISTS, "before": b"\3" + b"\0" * 12 + b"\0"},
        {"element": "element time 1\nproperty float t", "before": b"0.5\n", "text": True},
    ],
    ids=str,
)
def test_ply_is_read_however_it_is_written(tmp_path, how):
    given, back = points(40, 1), read_ply(rewrite(tmp_path / "a.ply", **how))
    for name in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(back, name), getattr(given, name), rtol=1e-5, atol=1e-6, err_msg=name)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 2\n", "row 1 of its element vertex .counted from 0. is '1 2'"),
        ("1 2 3 4\n", "expected 3 numbers"),
        ("1 2 x\n", "'1 2 x', expected 3 numbers"),
        ("", "ends after 1 of 2 lines"),
    ],
)
def test_damaged_text_names_the_row(tmp_path, text, said):
    header = (
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    (tmp_path / "a.ply").write_text(header + "0 0 0\n" + text)
    with pytest.raises(GaussiansError, match=said):
        read_ply(tmp_path / "a.ply")


def test_text_holds_nan_of_any_system(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 4\n"
    header += "".join(
        f"property float {name}\n" for name in ("x", "y", "z", "scale_0", "opacity", "f_dc_0", "f_dc_1", "f_dc_2")
    )
    rows = "".join(f"{x} 0 0 -3 1.5 0 0 0\n" for x in ("nan", "-nan(ind)", "1.#QNAN", "7"))
    (tmp_path / "a.ply").write_text(header + "end_header\n" + rows)
    remarks = Remarks()
    assert read_ply(tmp_path / "a.ply", remarks=remarks).means.tolist() == [[7, 0, 0]]
    assert any("3 points with NaN" in line for line in remarks.lines())


def test_far_positions_keep_their_precision(tmp_path):
    origin = np.array([5.4e6, -3.2e5, 12.5])
    write_ply(tmp_path / "a.ply", points(40, 1), origin)
    back = read_ply(tmp_path / "a.ply", origin)
    np.testing.assert_allclose(back.means, points(40, 1).means, atol=1e-6)
    np.testing.assert_allclose(back.sh, points(40, 1).sh, atol=1e-6)
