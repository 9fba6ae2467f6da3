"""Gaussians as binary glTF with the Khronos extension KHR_gaussian_splatting.

A primitive of points stores the attributes as `Gaussians` has them, with quaternions as xyzw. COLOR_0 serves viewers
that only support points. The node has no rotation, because some readers do not apply it to spherical harmonics.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.atomic import write_bytes
from splatreel.scene.gaussians import Gaussians

_FLOAT, _BYTE, _ARRAY_BUFFER = 5126, 5121, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_PREFIX = "KHR_gaussian_splatting:"
_EXTENSION = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "sortingMethod": "cameraDistance",
    "projection": "perspective",
}


def write_glb(path: str | Path, gaussians: Gaussians, shift: np.ndarray | None = None) -> None:
    """Write a .glb file atomically. The y axis of glTF is up.

    `shift`: Translation of the scene, [3] float64; None is 0, 0, 0.

    Raises:
        StorageError: The file cannot be written.
    """
    arrays = _attributes(gaussians)
    views, accessors, offset = [], [], 0
    for name, array in arrays.items():
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": _ARRAY_BUFFER})
        accessor = {"bufferView": len(accessors), "componentType": _BYTE if name == "COLOR_0" else _FLOAT}
        accessor |= {"count": len(array), "type": _TYPES[array.shape[1]]}
        if name == "COLOR_0":
            accessor["normalized"] = True
        if name == "POSITION" and len(array):
            accessor |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        accessors.append(accessor)
        offset += array.nbytes
    moved = {} if shift is None else {"translation": shift.tolist()}
    if not len(gaussians):  # glTF has no accessors without elements
        asset = {"version": "2.0", "generator": "Splatreel"}
        empty = {"asset": asset, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [moved or {"name": "empty"}]}
        return _write_document(path, empty, b"")
    primitive = {"attributes": {name: i for i, name in enumerate(arrays)}, "mode": 0}
    document = {
        "asset": {"version": "2.0", "generator": "Splatreel"},
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0} | moved],
        "meshes": [{"primitives": [primitive | {"extensions": {"KHR_gaussian_splatting": _EXTENSION}}]}],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return _write_document(path, document, b"".join(array.tobytes() for array in arrays.values()))


def _write_document(path: str | Path, document: dict[str, Any], body: bytes) -> None:
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if body:
        chunks += struct.pack("<II", len(body), 0x004E4942) + body
    write_bytes(Path(path), struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _attributes(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Return attributes by name, [N, 1], [N, 3] or [N, 4]: float32, except COLOR_0. All rows are multiples of four bytes."""
    color = np.concatenate([gaussians.base_colors, gaussians.opacities[:, None]], 1)
    arrays = {
        "POSITION": gaussians.means,
        "COLOR_0": np.rint(np.clip(color, 0, 1) * 255).astype(np.uint8),
        f"{_PREFIX}ROTATION": np.roll(gaussians.quats, -1, axis=1),
        f"{_PREFIX}SCALE": gaussians.scales,
        f"{_PREFIX}OPACITY": gaussians.opacities[:, None],
    }
    for degree in range(gaussians.sh_degree + 1):
        for order in range(2 * degree + 1):
            arrays[f"{_PREFIX}SH_DEGREE_{degree}_COEF_{order}"] = gaussians.sh[:, degree**2 + order]
    return arrays
