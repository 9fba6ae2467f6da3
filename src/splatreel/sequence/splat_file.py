"""Reader of one file of Gaussians: PLY, compressed PLY, SPZ, SOG, .splat, .ksplat."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.errors import GaussiansError
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.packed_columns import is_packed, unpack_columns
from splatreel.scene.ply_table import Columns, read_elements
from splatreel.scene.remarks import Remarks
from splatreel.scene.splat import SPLAT
from splatreel.scene.splat_columns import Encoding, gaussians_of
from splatreel.scene.turning import turned
from splatreel.scene.untrusted import read_file
from splatreel.sequence.ksplat_file import read_ksplat
from splatreel.sequence.plausible import check_plausible
from splatreel.sequence.sog_file import META, read_sog
from splatreel.sequence.spz_file import read_spz

SUFFIXES = (".ply", ".splat", ".ksplat", ".spz", ".sog")
"""Suffixes of files that hold one frame."""
SOG_FOLDER = META
"""File that makes a folder an unpacked SOG file."""
MOST_BYTES = 1 << 34
CERTAIN = Encoding(certain=True)
"""Storage of formats that define it."""
HALF_TURN, FLIP = np.array([0.0, 1, 0, 0]), np.array([1, -1, -1])
"""Half a turn about x, from up to down, wxyz, and the signs of positions after it."""


def read_splats(path: Path, origin: np.ndarray | None, remarks: Remarks, encoding: Encoding | None = None) -> Gaussians:
    """Read a file of Gaussians with axes as in a 3DGS PLY file: right, down, front.

    Args:
        path: Input file, or the meta.json of an unpacked SOG file.
        origin: Point subtracted from all positions before rounding to float32, [3] float64; None subtracts nothing.
        remarks: Receives what was converted or dropped.
        encoding: How a PLY file stores opacities and scales; None recognizes it.

    Raises:
        GaussiansError: The file cannot be read. The message names it.
    """
    suffix = path.suffix.lower()
    if suffix == ".ply":
        _check_not_deformed(path)
        elements = read_elements(path, ("chunk", "vertex", "sh"))
        columns = elements.get("vertex")
        if columns is None:
            raise GaussiansError(f"{path}: has no points (element vertex).")
        if is_packed(columns):
            columns, encoding = unpack_columns(elements, str(path)), CERTAIN
        points = gaussians_of(columns, str(path), origin, remarks, encoding)
    elif suffix == ".spz":  # its axes are right, up, back
        shift = None if origin is None else origin * FLIP
        points = turned(gaussians_of(read_spz(path, remarks), str(path), shift, remarks, CERTAIN), HALF_TURN)
    elif suffix == ".splat":
        points = gaussians_of(_read_splat(path), str(path), origin, remarks, CERTAIN)
    elif suffix == ".ksplat":
        points = gaussians_of(read_ksplat(path), str(path), origin, remarks, CERTAIN)
    else:
        points = gaussians_of(read_sog(path), str(path), origin, remarks, CERTAIN)
    return check_plausible(points, str(path))


def columns_of(path: Path) -> Columns | None:
    """Return the columns of a PLY file that is not compressed, otherwise None. Raises as `read_splats` does."""
    if path.suffix.lower() != ".ply":
        return None
    columns = read_elements(path, ("vertex",)).get("vertex", {})
    return None if is_packed(columns) else columns


def _check_not_deformed(path: Path) -> None:
    """Raise `GaussiansError` if a network beside the file moves its points."""
    network = path.parent / "deformation.pth"
    if network.exists():
        raise GaussiansError(
            f"{path}: is the model of 4DGaussians before its network {network.name} moves it. Run that method's "
            "export_perframe_3DGS.py, and import the folder that it writes."
        )


def _read_splat(path: Path) -> Columns:
    """Return the columns of a .splat file: 32 bytes per point, without view-dependent color."""
    data = read_file(path, MOST_BYTES, GaussiansError)
    if len(data) % SPLAT.itemsize:
        raise GaussiansError(f"{path}: has {len(data)} bytes, no multiple of {SPLAT.itemsize}. Copy it again.")
    table = np.frombuffer(data, SPLAT)
    base = (table["color"][:, :3] / 255 - 0.5) / C0
    quats = (table["turn"].astype(np.float64) - 128) / 128
    found = {name: table["means"][:, i] for i, name in enumerate("xyz")} | {"opacity": table["color"][:, 3]}
    scales = np.log(np.maximum(table["scales"], np.finfo(np.float32).tiny))
    found |= {f"scale_{i}": scales[:, i] for i in range(3)} | {f"f_dc_{i}": base[:, i] for i in range(3)}
    return found | {f"rot_{i}": quats[:, i] for i in range(4)}
