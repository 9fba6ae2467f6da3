"""Gaussians as the PLY file of 3D Gaussian Splatting, which common viewers and editors open."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import GaussiansError
from splatreel.base.ply_table import Columns, read_elements
from splatreel.formats.splat_columns import Encoding, Remarks, gaussians_of
from splatreel.scene.gaussians import Gaussians

_MODE = "SplatRenderMode: "
"""Comment of a PLY file that states how its points are drawn, as Brush and splat-transform write it: default, mip or 2dgs."""


def mode_comments(antialias: bool) -> list[str]:
    """Return the header lines that mark points as trained with antialiasing. Unmarked files were trained without."""
    return [f"comment {_MODE}mip"] if antialias else []


def splat_mode(comments: Iterable[str]) -> str:
    """Return how the comments of a PLY file say that its points are drawn: default, mip or 2dgs.

    Source:
        Brush's "SplatRenderMode: mip" (ArthurBrussee/brush, brush-serde), and Postshot's "antialiased 1", both as splat-transform
        reads them (playcanvas/splat-transform, read-ply.ts). The last comment counts.
    """
    mode = "default"
    for comment in comments:
        name, _, value = comment.strip().lower().partition(" ")
        if name == _MODE.strip().lower() and value.strip() in ("default", "mip", "2dgs"):
            mode = value.strip()
        if name == "antialiased" and value.strip() in ("0", "1"):
            mode = "mip" if value.strip() == "1" else "default"
    return mode


def write_ply(
    path: str | Path, gaussians: Gaussians, origin: np.ndarray | None = None, antialias: bool = False
) -> None:
    """Write a binary PLY file atomically.

    Properties are x y z nx ny nz f_dc_* f_rest_* (red, then green, then blue) opacity scale_* rot_*. Opacities are
    stored as logits and scales as natural logarithms, as 3DGS renderers expect.

    Args:
        path: Output file.
        gaussians: Gaussians to write.
        origin: Point added to all positions, [3] float64, which are then stored as double; None adds nothing.
        antialias: Value of the mark of antialiasing, as for `render_image`.

    Raises:
        StorageError: The file cannot be written.
    """
    path = Path(path)
    opacities = np.clip(gaussians.opacities.astype(np.float64), 1e-6, 1 - 1e-6)
    columns = [
        gaussians.means if origin is None else gaussians.means.astype(np.float64) + origin,
        np.zeros_like(gaussians.means),
        gaussians.sh[:, 0],
        gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(len(gaussians), -1 if len(gaussians) else 0),
        np.log(opacities / (1 - opacities))[:, None],
        np.log(np.maximum(gaussians.scales, np.finfo(np.float32).tiny)),
        gaussians.quats,
    ]
    names = _property_names(3 * (gaussians.sh.shape[1] - 1) if len(gaussians) else 0)
    header = ["ply", "format binary_little_endian 1.0", *mode_comments(antialias), f"element vertex {len(gaussians)}"]
    kinds = {name: "double" if origin is not None and name in ("x", "y", "z") else "float" for name in names}
    header += [f"property {kind} {name}" for name, kind in kinds.items()] + ["end_header", ""]
    table = np.empty(len(gaussians), [(name, "<f8" if kind == "double" else "<f4") for name, kind in kinds.items()])
    for name, column in zip(names, np.concatenate(columns, 1).T, strict=False):
        table[name] = column
    write_bytes(path, "\n".join(header).encode() + table.tobytes())


def read_ply(
    path: str | Path,
    origin: np.ndarray | None = None,
    remarks: Remarks | None = None,
    encoding: Encoding | None = None,
) -> Gaussians:
    """Read a PLY file of Gaussians: text or binary, SH degree 0 to 4, with the columns of 3DGS or similar ones.

    Args:
        path: Input file.
        origin: Point subtracted from all positions before rounding to float32, [3] float64; None subtracts nothing.
        remarks: Receives what was converted or dropped.
        encoding: How opacities and scales are stored; None recognizes it.

    Raises:
        GaussiansError: The file is not such a PLY file.
    """
    return gaussians_of(read_columns(path), str(path), origin, remarks or Remarks(), encoding)


def read_columns(path: str | Path) -> Columns:
    """Return the columns of the points of a PLY file.

    Raises:
        GaussiansError: The file is not a PLY file, is damaged, or holds no points.
    """
    columns = read_elements(path, ("vertex",)).get("vertex")
    if columns is None:
        raise GaussiansError(f"{path}: has no points (element vertex).")
    return columns


def _property_names(rest: int) -> list[str]:
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(rest)]
    return [*names, "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
