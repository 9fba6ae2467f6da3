"""Reader of one file of Gaussians: PLY, compressed PLY, SPZ, SOG, .splat."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.errors import GaussiansError
from splatreel.scene import rotations
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.packed_columns import is_packed, unpack_columns
from splatreel.scene.ply_table import Columns, read_elements
from splatreel.scene.remarks import Remarks
from splatreel.scene.splat_columns import Encoding, drop_nan, gaussians_of
from splatreel.scene.turning import turned
from splatreel.scene.untrusted import UNPACKED_BYTES, UNPACKED_RATIO, read_file
from splatreel.sequence.plausible import check_plausible

SUFFIXES = (".ply", ".splat", ".spz", ".sog")
"""Suffixes of files that hold one frame."""
SOG_FOLDER = "meta.json"
"""File that makes a folder an unpacked SOG file."""
MOST_BYTES = 1 << 34
HALF_TURN, FLIP = np.array([0.0, 1, 0, 0]), np.array([1, -1, -1])
"""Half a turn about x, from up to down, wxyz, and the signs of positions after it."""
_SPLAT = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("color", "u1", 4), ("turn", "u1", 4)])
_SPZ_HEADER, _SPZ_FLAGS, _SPZ_ANTIALIASED = 16, 14, 1


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
            columns, encoding = unpack_columns(elements, str(path)), Encoding()
        return check_plausible(gaussians_of(columns, str(path), origin, remarks, encoding), str(path))
    if suffix == ".spz":
        _check_spz(path, remarks)
        found = _from_gsply("read_spz", path)
    elif suffix in (".sog", ".json"):
        found = _from_gsply("sogread", path)
    else:
        found = _read_splat(path)
    upright = suffix == ".spz"  # its axes are right, up, back
    shift = np.zeros(3) if origin is None else origin * (FLIP if upright else 1)
    points = Gaussians(found[0] - shift, *found[1:])
    points = turned(points, HALF_TURN) if upright else points
    return check_plausible(drop_nan(points, str(path), remarks), str(path))


def columns_of(path: Path) -> Columns | None:
    """Return the columns of a PLY file that is not compressed, otherwise None. Raises as `read_splats` does."""
    if path.suffix.lower() != ".ply":
        return None
    columns = read_elements(path, ("vertex",)).get("vertex", {})
    return None if is_packed(columns) else columns


Arrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Positions in float64, quaternions, scales, opacities and harmonics, activated."""


def _check_not_deformed(path: Path) -> None:
    """Raise `GaussiansError` if a network beside the file moves its points."""
    network = path.parent / "deformation.pth"
    if network.exists():
        raise GaussiansError(
            f"{path}: is the model of 4DGaussians before its network {network.name} moves it. Run that method's "
            "export_perframe_3DGS.py, and import the folder that it writes."
        )


def _from_gsply(name: str, path: Path) -> Arrays:
    """Return the content of a file that the package gsply reads."""
    try:
        import gsply  # pyright: ignore[reportMissingImports] - optional

        data: Any = getattr(gsply, name)(str(path))
    except ImportError as error:
        raise GaussiansError(
            f"{path}: needs a package to be read ({error.name}). Run\n  pip install 'splatreel[splats]'"
        ) from error
    except Exception as error:
        raise GaussiansError(f"{path}: is damaged, or of another version ({error!s:.100}). Export it again.") from error
    base = np.asarray(data.sh0, np.float64).reshape(len(data.means), 1, 3)
    rest = np.zeros((len(base), 0, 3)) if data.shN is None else np.asarray(data.shN).reshape(len(base), -1, 3)
    return (
        np.asarray(data.means, np.float64),
        rotations.normalize(np.asarray(data.quats, np.float64)),
        np.exp(np.minimum(np.asarray(data.scales, np.float64), 80)),
        1 / (1 + np.exp(-np.clip(np.asarray(data.opacities, np.float64).reshape(-1), -80, 80))),
        np.concatenate([base, rest], 1),
    )


def _check_spz(path: Path, remarks: Remarks) -> None:
    """Check that an SPZ file unpacks to a plausible size, and remark on its antialiasing flag."""
    data = read_file(path, MOST_BYTES, GaussiansError)
    header = data[:_SPZ_HEADER]
    if data[:2] == b"\x1f\x8b":
        most = max(UNPACKED_BYTES, UNPACKED_RATIO * len(data))
        try:
            stream = zlib.decompressobj(31)
            header = stream.decompress(data, _SPZ_HEADER)
            size = len(header)
            while not stream.eof and stream.unconsumed_tail and size <= most:
                size += len(stream.decompress(stream.unconsumed_tail, 1 << 20))
        except zlib.error as error:
            raise GaussiansError(f"{path}: is a damaged SPZ file ({error}). Copy it again.") from error
        if size > most:
            raise GaussiansError(f"{path}: would unpack to more than {most:,} bytes. Export it again.")
    if len(header) == _SPZ_HEADER and header[_SPZ_FLAGS] & _SPZ_ANTIALIASED:
        remarks.add("Points are marked as trained with antialiasing: import them with --antialiased", path)


def _read_splat(path: Path) -> Arrays:
    """Return the content of a .splat file: 32 bytes per point, without view-dependent color."""
    data = read_file(path, MOST_BYTES, GaussiansError)
    if len(data) % _SPLAT.itemsize:
        raise GaussiansError(f"{path}: has {len(data)} bytes, no multiple of {_SPLAT.itemsize}. Copy it again.")
    table = np.frombuffer(data, _SPLAT)
    color = table["color"] / 255
    sh = ((color[:, :3] - 0.5) / C0)[:, None]
    quats = rotations.normalize((table["turn"].astype(np.float64) - 128) / 128)
    return table["means"].astype(np.float64), quats, table["scales"], color[:, 3], sh
