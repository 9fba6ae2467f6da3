"""Files of other programs. `tests/data/splats` holds 40 points that splat-transform 2.7.1 wrote and read again (expected.npz);
scene.splat was written by hand and read by it.
"""

import gzip
import json
import shutil
import struct
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.formats.ply import write_ply
from splatreel.formats.registry import FRAME_FORMATS, HALF_TURN, Placement, is_antialiased, read_splats
from splatreel.formats.splat_columns import Remarks
from splatreel.scene import rotations
from splatreel.scene.gaussians import C0
from tests.golden import random_gaussians

DATA = Path(__file__).parents[1] / "data" / "splats"
ORIGIN = np.array([1.0, -2.0, 3.0])
NAMES = ["v3.spz", "v4.spz", "scene.sog", "packed.compressed.ply", "scene.splat"]


def covariances(quats: np.ndarray, scales: np.ndarray) -> np.ndarray:
    axes = rotations.to_matrix(quats) * scales[:, None]
    return axes @ axes.transpose(0, 2, 1)


@pytest.mark.parametrize("name", NAMES)
def test_files_of_other_programs_are_read_as_they_read_them(name: str) -> None:
    if name == "v4.spz":
        pytest.importorskip("zstandard")
    expected = np.load(DATA / "expected.npz")
    given = {key: expected[f"{name}/{key}"] for key in ("means", "quats", "scales", "opacities", "sh")}
    found = read_splats(DATA / name, ORIGIN, Remarks())
    np.testing.assert_allclose(found.means + ORIGIN, given["means"], atol=1e-6)
    shapes = covariances(found.quats, found.scales), covariances(given["quats"], given["scales"])
    np.testing.assert_allclose(*shapes, atol=1e-3 if name == "scene.splat" else 1e-6)
    np.testing.assert_allclose(found.opacities, given["opacities"], atol=1e-6)
    np.testing.assert_allclose(found.sh, given["sh"], atol=1e-6)


@pytest.mark.parametrize("kind", ["ply", "compressed-ply", "sog", "spz", "spz2", "spz4"])
@pytest.mark.parametrize("antialias", [False, True])
def test_mark_of_antialiasing_is_written_and_read(tmp_path: Path, kind: str, antialias: bool) -> None:
    if kind == "spz4":
        pytest.importorskip("zstandard")
    points = random_gaussians(np.random.default_rng(0), 30, 1, (0, 0, 0))
    path = tmp_path / f"f{FRAME_FORMATS[kind].suffix}"
    FRAME_FORMATS[kind].write(path, points, Placement(np.array([1.0, 0, 0, 0]), antialias=antialias))
    assert is_antialiased(path, Remarks()) == antialias
    assert len(read_splats(path, None, Remarks())) == 30


@pytest.mark.parametrize(
    ("comments", "marked"),
    [
        (["SplatRenderMode: mip"], True),
        (["Exported from Brush", "splatrendermode: MIP "], True),
        (["SplatRenderMode: default"], False),
        (["SplatRenderMode: mip", "SplatRenderMode: default"], False),
        (["antialiased 1"], True),
        (["antialiased 0"], False),
        (["SplatRenderMode: 2dgs"], False),
        (["not SplatRenderMode: mip"], False),
    ],
)
@pytest.mark.parametrize("line_end", [b"\n", b"\r\n"])
def test_comments_of_other_programs_mark_antialiasing(
    tmp_path: Path, comments: list[str], marked: bool, line_end: bytes
) -> None:
    write_ply(tmp_path / "plain.ply", random_gaussians(np.random.default_rng(0), 30, 0, (0, 0, 0)))
    header, body = (tmp_path / "plain.ply").read_bytes().split(b"end_header\n")
    lines = header.replace(b"ply\n", b"ply\n" + "".join(f"comment {text}\n" for text in comments).encode(), 1)
    (tmp_path / "f.ply").write_bytes((lines + b"end_header\n").replace(b"\n", line_end) + body)
    remarks = Remarks()
    assert is_antialiased(tmp_path / "f.ply", remarks) == marked
    assert ("2DGS" in "".join(remarks.lines())) == ("2dgs" in comments[0])
    assert len(read_splats(tmp_path / "f.ply", None, Remarks())) == 30


@pytest.mark.parametrize("key", [{"antialias": True}, {"model": "antialiased"}])
def test_marks_of_sog_files_are_read(tmp_path: Path, key: dict[str, object]) -> None:
    shutil.unpack_archive(DATA / "scene.sog", tmp_path, "zip")
    assert not is_antialiased(tmp_path / "meta.json", Remarks())
    meta = json.loads((tmp_path / "meta.json").read_text())
    (tmp_path / "meta.json").write_text(json.dumps(meta | key))
    assert is_antialiased(tmp_path / "meta.json", Remarks())


@pytest.mark.parametrize("name", NAMES)
def test_cut_files_are_refused_by_name(tmp_path: Path, name: str) -> None:
    if name == "v4.spz":
        pytest.importorskip("zstandard")
    data = (DATA / name).read_bytes()
    file = tmp_path / name
    file.write_bytes(data[: len(data) - 300])
    with pytest.raises(GaussiansError) as caught:
        read_splats(file, None, Remarks())
    assert str(caught.value).startswith(f"{file}: ")


def test_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zstandard", None)
    with pytest.raises(GaussiansError, match=r'pip install "splatreel\[splats\]"'):
        read_splats(DATA / "v4.spz", None, Remarks())


@pytest.mark.parametrize("version", [1, 2])
def test_older_spz_files(tmp_path: Path, version: int) -> None:
    """Version 2 stores x, y, z of rotations as bytes, version 1 also positions as 16-bit floats."""
    head = struct.pack("<IIIBBBB", 0x5053474E, version, 1, 1, 12, 0, 0)
    place = np.array([1.5, -0.25, 2], "<f2").tobytes()
    if version == 2:
        place = b"".join(int(value * 4096).to_bytes(3, "little", signed=True) for value in (1.5, -0.25, 2))
    looks = bytes([51, 255, 128, 0, 160, 144, 128])  # opacity; color; logarithms of scales: 0, -1, -2
    rest = bytes([0, 191, 128, 0, 128, 192, 128, 128, 128, 128, 128, 128])[3:]
    file = tmp_path / "old.spz"
    file.write_bytes(gzip.compress(head + place + looks + bytes([0, 191, 128]) + rest))
    found = read_splats(file, None, Remarks())
    np.testing.assert_allclose(found.means, [[1.5, 0.25, -2]])
    np.testing.assert_allclose(found.opacities, [0.2], rtol=1e-5)
    np.testing.assert_allclose(np.log(found.scales), [[0, -1, -2]], atol=1e-5)
    xyz = np.array([0, 191, 128]) / 127.5 - 1
    quat = np.array([np.sqrt(max(1 - (xyz**2).sum(), 0)), *xyz])
    quat /= np.linalg.norm(quat)
    expected = rotations.multiply(HALF_TURN, quat)
    np.testing.assert_allclose(np.abs((found.quats[0] * expected).sum()), 1, atol=1e-5)
    np.testing.assert_allclose(found.sh[0, 1], [1, 0, -0.5], atol=1e-5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda meta: meta.pop("version"), "SOG file of version 1, only 2 is read"),
        (lambda meta: meta["scales"].update(codebook=[0.0]), "damaged SOG"),
        (lambda meta: meta.update(count=10**9), "damaged SOG"),
        (lambda meta: meta.update(count=5000), "of 5000 points"),
        (lambda meta: meta.update(count=10**5), r"claims 100,000 points of degree \d in .* --max-memory"),
        (lambda meta: meta["shN"]["files"].reverse(), "damaged SOG"),
        (lambda meta: meta["means"].update(files=[]), "damaged SOG"),
    ],
)
def test_damaged_sog_files_are_refused(tmp_path: Path, change: Callable[[dict], object], said: str) -> None:
    with zipfile.ZipFile(DATA / "scene.sog") as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    meta = json.loads(files["meta.json"])
    change(meta)
    with zipfile.ZipFile(tmp_path / "a.sog", "w") as archive:
        for name, data in (files | {"meta.json": json.dumps(meta).encode()}).items():
            archive.writestr(name, data)
    with pytest.raises(GaussiansError, match=said):
        read_splats(tmp_path / "a.sog", None, Remarks())


def test_unpacked_sog_folder(tmp_path: Path) -> None:
    shutil.unpack_archive(DATA / "scene.sog", tmp_path, "zip")
    found = read_splats(tmp_path / "meta.json", None, Remarks())
    np.testing.assert_allclose(found.means, np.load(DATA / "expected.npz")["scene.sog/means"], atol=1e-6)


def test_compressed_ply_of_older_versions_has_no_range_of_colors(tmp_path: Path) -> None:
    """Chunks had 12 numbers before they had 18."""
    header, body = (DATA / "packed.compressed.ply").read_bytes().split(b"end_header\n", 1)
    lines = [line for line in header.split(b"\n") if not line.endswith((b"_r", b"_g", b"_b"))]
    chunk = np.frombuffer(body[: 4 * 18], "<f4")
    file = tmp_path / "old.compressed.ply"
    file.write_bytes(b"\n".join(lines) + b"end_header\n" + chunk[:12].tobytes() + body[4 * 18 :])
    old, new = (read_splats(path, None, Remarks()) for path in (file, DATA / "packed.compressed.ply"))
    np.testing.assert_array_equal(old.means, new.means)
    low, high = chunk[12:15], chunk[15:18]
    colors = (old.sh[:, 0] * C0 + 0.5) * (high - low) + low
    np.testing.assert_allclose(colors, new.sh[:, 0] * C0 + 0.5, atol=1e-5)


def test_compressed_ply_with_missing_parts_is_refused(tmp_path: Path) -> None:
    data = (DATA / "packed.compressed.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data.replace(b"property float max_x", b"property float other"))
    with pytest.raises(GaussiansError, match="with missing parts"):
        read_splats(tmp_path / "a.ply", None, Remarks())
