"""Binary glTF with KHR_gaussian_splatting, read by an independent reader."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from splatreel.formats.glb import write_glb
from splatreel.scene.gaussians import Gaussians
from tests.golden import random_gaussians

WIDTH = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
TYPES = {5126: "<f4", 5121: "u1"}


def read_glb(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Return the document and the attribute arrays of its only primitive."""
    data = path.read_bytes()
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert (kind, size % 4) == (b"JSON", 0)
    document = json.loads(data[20 : 20 + size])
    held, kind = struct.unpack_from("<I4s", data, 20 + size)
    body = data[28 + size :]
    assert (kind, held, document["buffers"][0]["byteLength"]) == (b"BIN\0", len(body), len(body))
    arrays = {}
    for name, index in document["meshes"][0]["primitives"][0]["attributes"].items():
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        count, width = accessor["count"], WIDTH[accessor["type"]]
        flat = np.frombuffer(body, TYPES[accessor["componentType"]], count * width, view["byteOffset"])
        arrays[name] = flat.reshape(count, width)
    return document, arrays


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_glb_round_trips(tmp_path: Path, degree: int) -> None:
    given = random_gaussians(np.random.default_rng(degree), 50, degree, (1, -2, 3))
    write_glb(tmp_path / "f.glb", given)
    document, arrays = read_glb(tmp_path / "f.glb")
    splatting = {name.removeprefix("KHR_gaussian_splatting:"): array for name, array in arrays.items()}
    assert np.array_equal(splatting["POSITION"], given.means)
    assert np.array_equal(splatting["ROTATION"][:, [3, 0, 1, 2]], given.quats)
    assert np.array_equal(splatting["SCALE"], given.scales)
    assert np.array_equal(splatting["OPACITY"][:, 0], given.opacities)
    sh = [splatting[f"SH_DEGREE_{d}_COEF_{i}"] for d in range(degree + 1) for i in range(2 * d + 1)]
    assert np.array_equal(np.stack(sh, 1), given.sh)
    assert np.abs(splatting["COLOR_0"][:, 3] / 255 - given.opacities).max() < 0.003
    primitive = document["meshes"][0]["primitives"][0]
    assert (primitive["mode"], document["extensionsUsed"]) == (0, ["KHR_gaussian_splatting"])
    assert primitive["extensions"]["KHR_gaussian_splatting"]["colorSpace"] == "srgb_rec709_display"
    positions = document["accessors"][primitive["attributes"]["POSITION"]]
    assert positions["min"] == given.means.min(0).tolist()


def test_glb_node_moves_and_does_not_turn(tmp_path: Path) -> None:
    shift = np.array([5.4e6, 1.25, -2])
    points = random_gaussians(np.random.default_rng(0), 2, 0, (0.0, 0.0, 0.0))
    write_glb(tmp_path / "f.glb", points, shift)
    assert read_glb(tmp_path / "f.glb")[0]["nodes"][0] == {"mesh": 0, "translation": shift.tolist()}
    write_glb(tmp_path / "f.glb", points)
    assert read_glb(tmp_path / "f.glb")[0]["nodes"][0] == {"mesh": 0}


def test_file_without_gaussians_has_a_scene_without_meshes(tmp_path: Path) -> None:
    """glTF has no accessors without elements."""
    write_glb(tmp_path / "f.glb", Gaussians.empty(1))
    data = (tmp_path / "f.glb").read_bytes()
    length, kind = struct.unpack_from("<II", data, 12)
    document = json.loads(data[20 : 20 + length])
    assert struct.unpack_from("<4sII", data) == (b"glTF", 2, len(data))
    assert (kind, len(data)) == (0x4E4F534A, 20 + length)
    assert document["nodes"] == [{"name": "empty"}]
    assert not {"meshes", "accessors", "bufferViews", "buffers"} & document.keys()
