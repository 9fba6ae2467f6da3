"""Reader of one file of Gaussians: PLY, compressed PLY, SPZ, SOG, .splat, .ksplat."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, points_memory
from splatreel.base.untrusted import read_file
from splatreel.formats.compressed_ply import is_packed, unpack_columns
from splatreel.formats.ksplat import read_ksplat
from splatreel.formats.plausible import check_plausible
from splatreel.formats.ply import splat_mode
from splatreel.formats.ply_table import Columns, read_comments, read_elements
from splatreel.formats.remarks import Remarks
from splatreel.formats.sog import META, is_sog_antialiased, read_sog
from splatreel.formats.splat import SPLAT
from splatreel.formats.splat_columns import Encoding, gaussians_of
from splatreel.formats.spz import is_spz_antialiased, read_spz
from splatreel.formats.streamed_sog import LOD_META, files_of, is_streamed_sog_antialiased, read_streamed_sog
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.turning import turned

SUFFIXES = (".ply", ".splat", ".ksplat", ".spz", ".sog")
"""Suffixes of files that hold one frame."""
SOG_FOLDERS = (LOD_META, META)
"""Files that make a folder a streamed or an unpacked SOG file."""
MOST_BYTES = 1 << 34
CERTAIN = Encoding(certain=True)
"""Storage of formats that define it."""
HALF_TURN, FLIP = np.array([0.0, 1, 0, 0]), np.array([1, -1, -1])
"""Half a turn about x, from up to down, wxyz, and the signs of positions after it."""


def read_splats(
    path: Path,
    origin: np.ndarray | None,
    remarks: Remarks,
    encoding: Encoding | None = None,
    budget: MemoryBudget = UNRAISED,
) -> Gaussians:
    """Read a file of Gaussians with axes as in a 3DGS PLY file: right, down, front.

    Args:
        path: Input file, the meta.json of an unpacked SOG file, or the lod-meta.json of a streamed one.
        origin: Point subtracted from all positions before rounding to float32, [3] float64; None subtracts nothing.
        remarks: Receives what was converted or dropped.
        encoding: How a PLY file stores opacities and scales; None recognizes it.
        budget: Memory that reading may take.

    Raises:
        GaussiansError: The file cannot be read. The message names it.
    """
    suffix = path.suffix.lower()
    if suffix == ".ply":
        elements = read_elements(path, ("chunk", "vertex", "sh"), budget)
        columns = elements.get("vertex")
        if columns is None:
            raise GaussiansError(f"{path}: has no points (element vertex).")
        if is_packed(columns):
            columns, encoding = unpack_columns(elements, str(path)), CERTAIN
        points = gaussians_of(columns, str(path), origin, remarks, encoding)
    elif suffix == ".spz":  # its axes are right, up, back
        shift = None if origin is None else origin * FLIP
        points = turned(gaussians_of(read_spz(path, budget), str(path), shift, remarks, CERTAIN), HALF_TURN)
    else:
        if suffix == ".splat":
            columns = _read_splat(path, budget)
        elif suffix == ".ksplat":
            columns = read_ksplat(path, budget)
        else:
            is_streamed = path.name == LOD_META
            columns = read_streamed_sog(path, remarks, budget) if is_streamed else read_sog(path, budget)
        points = gaussians_of(columns, str(path), origin, remarks, CERTAIN)
    return check_plausible(points, str(path))


def is_antialiased(path: Path, remarks: Remarks) -> bool:
    """Return whether a file marks its points as trained with antialiasing. Raises as `read_splats` does.

    Args:
        path: Input file as for `read_splats`.
        remarks: Receives a remark on points of 2DGS, which are drawn as thin Gaussians.
    """
    suffix = path.suffix.lower()
    if suffix == ".ply":
        mark = splat_mode(read_comments(path))
        if mark == "2dgs":
            remarks.add("Points are marked as those of 2DGS: they were read as thin Gaussians", path)
        return mark == "mip"
    if suffix == ".spz":
        return is_spz_antialiased(path)
    if suffix in (".splat", ".ksplat"):  # they have no mark
        return False
    return is_streamed_sog_antialiased(path) if path.name == LOD_META else is_sog_antialiased(path)


def columns_of(path: Path, budget: MemoryBudget = UNRAISED) -> Columns | None:
    """Return the columns of a PLY file that is not compressed, otherwise None. Raises as `read_splats` does."""
    if path.suffix.lower() != ".ply":
        return None
    columns = read_elements(path, ("vertex",), budget).get("vertex", {})
    return None if is_packed(columns) else columns


def size_of(path: Path) -> int:
    """Return the bytes of a file as for `read_splats`, with the images of an unpacked SOG file. Raises as that does."""
    size = path.stat().st_size
    if path.name == META:
        size += sum(file.stat().st_size for file in path.parent.glob("*.webp"))
    if path.name == LOD_META:
        size += sum(size_of(file) for file in files_of(path) if file.is_file())
    return size


def _read_splat(path: Path, budget: MemoryBudget) -> Columns:
    """Return the columns of a .splat file: 32 bytes per point, without view-dependent color."""
    data = read_file(path, MOST_BYTES, GaussiansError)
    if len(data) % SPLAT.itemsize:
        raise GaussiansError(f"{path}: has {len(data)} bytes, no multiple of {SPLAT.itemsize}. Copy it again.")
    count = len(data) // SPLAT.itemsize
    budget.check(len(data) + points_memory(count), len(data), str(path), f"{count:,} points")
    table = np.frombuffer(data, SPLAT)
    base = (table["color"][:, :3] / 255 - 0.5) / C0
    quats = (table["turn"].astype(np.float64) - 128) / 128
    found = {name: table["means"][:, i] for i, name in enumerate("xyz")} | {"opacity": table["color"][:, 3]}
    scales = np.log(np.maximum(table["scales"], np.finfo(np.float32).tiny))
    found |= {f"scale_{i}": scales[:, i] for i in range(3)} | {f"f_dc_{i}": base[:, i] for i in range(3)}
    return found | {f"rot_{i}": quats[:, i] for i in range(4)}
