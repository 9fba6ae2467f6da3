"""Gaussians as the PLY file of 3D Gaussian Splatting, which common viewers and editors open."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from splatreel.errors import GaussiansError
from splatreel.scene import rotations
from splatreel.scene.atomic import write_bytes
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.untrusted import open_regular

_MAX_HEADER = 1 << 16
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "<i2"),
    **dict.fromkeys(("ushort", "uint16"), "<u2"),
    **dict.fromkeys(("int", "int32"), "<i4"),
    **dict.fromkeys(("uint", "uint32"), "<u4"),
    **dict.fromkeys(("float", "float32"), "<f4"),
    **dict.fromkeys(("double", "float64"), "<f8"),
}


def write_ply(path: str | Path, gaussians: Gaussians) -> None:
    """Write a binary PLY file atomically.

    Properties are x y z nx ny nz f_dc_* f_rest_* (red, then green, then blue) opacity scale_* rot_*. Opacities are
    stored as logits and scales as natural logarithms, as 3DGS renderers expect.

    Raises:
        GaussiansError: The file cannot be written.
    """
    path = Path(path)
    opacities = np.clip(gaussians.opacities.astype(np.float64), 1e-6, 1 - 1e-6)
    columns = [
        gaussians.means,
        np.zeros_like(gaussians.means),
        gaussians.sh[:, 0],
        gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(len(gaussians), -1 if len(gaussians) else 0),
        np.log(opacities / (1 - opacities))[:, None],
        np.log(np.maximum(gaussians.scales, np.finfo(np.float32).tiny)),
        gaussians.quats,
    ]
    names = _property_names(3 * (gaussians.sh.shape[1] - 1) if len(gaussians) else 0)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(gaussians)}"]
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    data = "\n".join(header).encode() + np.concatenate(columns, 1).astype("<f4").tobytes()
    write_bytes(path, data)


def read_ply(path: str | Path, origin: np.ndarray | None = None) -> Gaussians:
    """Read a binary 3DGS PLY file of SH degree 0 to 3.

    Args:
        path: Input file.
        origin: Point subtracted from all positions before rounding to float32, [3] float64; None subtracts nothing.

    Raises:
        GaussiansError: The file is not such a PLY file.
    """
    path = Path(path)
    try:
        with open_regular(path, GaussiansError) as file:
            head = file.read(_MAX_HEADER)
            count, dtype, start = _parse_header(head, path)
            size, held = count * dtype.itemsize, os.fstat(file.fileno()).st_size - start
            if held < size:
                raise GaussiansError(f"{path}: ends after {held} of {size} bytes of points. Copy it again.")
            file.seek(start)
            data = file.read(size)
    except OSError as error:
        raise GaussiansError(f"{path}: cannot be read ({error.strerror}).") from error
    table = np.frombuffer(data, dtype, count)
    gaussians = _from_table(table, path, origin)
    gaussians.check_finite(str(path))
    return gaussians


def _property_names(rest: int) -> list[str]:
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(rest)]
    return [*names, "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


def _parse_header(head: bytes, path: Path) -> tuple[int, np.dtype, int]:
    """Return the number of points, their record type, and the offset of the first record."""
    end = head.find(b"end_header\n")
    lines = head[: max(end, 0)].decode("latin-1").split("\n")
    if end < 0 or lines[0].strip() != "ply" or "format binary_little_endian 1.0" not in lines:
        raise GaussiansError(f"{path}: is not a binary little-endian PLY file.")
    count, properties, element = 0, [], ""
    for line in lines:
        words = line.split()
        if words[:1] == ["element"] and len(words) == 3:
            if element and not properties:
                raise GaussiansError(f"{path}: its points (element vertex) do not come first.")
            element = words[1]
            count = _count(words[2], path) if element == "vertex" else count
        elif words[:1] == ["property"] and element == "vertex":
            if len(words) != 3 or words[1] not in _TYPES:
                raise GaussiansError(f"{path}: has the point property {line!r:.100}, expected a plain number.")
            properties.append((words[2], _TYPES[words[1]]))
    if len({name for name, _ in properties}) != len(properties):
        raise GaussiansError(f"{path}: names a point property twice.")
    return count, np.dtype(properties), end + len(b"end_header\n")


def _count(word: str, path: Path) -> int:
    if not word.isdecimal() or len(word) > 10:
        raise GaussiansError(f"{path}: claims to hold {word!r:.40} points.")
    return int(word)


def _from_table(table: np.ndarray, path: Path, origin: np.ndarray | None) -> Gaussians:
    names = table.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    missing = [name for name in _property_names(rest) if name not in names and name not in ("nx", "ny", "nz")]
    if missing or rest not in (0, 9, 24, 45):
        raise GaussiansError(
            f"{path}: is not a PLY of 3D Gaussians: missing {', '.join(missing) or 'nothing'}, {rest} f_rest properties."
        )

    def columns(*wanted: str) -> np.ndarray:
        return np.stack([table[name].astype(np.float64) for name in wanted], -1)

    sh = columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    if rest:
        higher = columns(*(f"f_rest_{i}" for i in range(rest))).reshape(len(table), 3, rest // 3)
        sh = np.concatenate([sh, higher.transpose(0, 2, 1)], 1)
    return Gaussians(
        means=columns("x", "y", "z") - (0.0 if origin is None else origin),
        quats=rotations.normalize(columns("rot_0", "rot_1", "rot_2", "rot_3")),
        scales=np.exp(np.minimum(columns("scale_0", "scale_1", "scale_2"), 80)),
        opacities=1 / (1 + np.exp(-np.clip(table["opacity"].astype(np.float64), -80, 80))),
        sh=sh,
    )
