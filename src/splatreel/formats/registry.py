"""Registry of the formats of files that hold the Gaussians of one frame: which function reads and which writes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget
from splatreel.base.ply_table import Columns, read_comments, read_elements
from splatreel.formats.compressed_ply import is_packed, unpack_columns, write_compressed_ply
from splatreel.formats.glb import write_glb
from splatreel.formats.ksplat import read_ksplat
from splatreel.formats.ply import splat_mode, write_ply
from splatreel.formats.sog import META, is_sog_antialiased, read_sog, write_sog
from splatreel.formats.splat import read_splat, write_splat
from splatreel.formats.splat_columns import Encoding, Remarks, check_plausible, gaussians_of
from splatreel.formats.spz import Version, is_spz_antialiased, read_spz, write_spz
from splatreel.formats.streamed_sog import LOD_META, files_of, is_streamed_sog_antialiased, read_streamed_sog
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians, turned


@dataclass(frozen=True)
class Placement:
    """Place of exported Gaussians in the axes of a file.

    Attributes:
        turn: Rotation of the scene, [4] wxyz.
        origin: Translation of the scene before it is rotated, [3] float64; None is 0, 0, 0.
        antialias: How splats are drawn, see `render_image`.
    """

    turn: np.ndarray
    origin: np.ndarray | None = None
    antialias: bool = False

    @property
    def shift(self) -> np.ndarray | None:
        """Translation after the rotation, [3] float64; None for none."""
        return None if self.origin is None else rotations.to_matrix(self.turn) @ np.asarray(self.origin, np.float64)


class Film(Protocol):
    """Gaussians at several times."""

    @property
    def seconds(self) -> Sequence[float]:
        """Times, in order."""
        ...

    @property
    def placement(self) -> Placement:
        """Place of the Gaussians in the axes of a file."""
        ...

    def at(self, seconds: float) -> Gaussians:
        """Return the Gaussians at a time."""
        ...

    def identified(self, seconds: float) -> tuple[Gaussians, np.ndarray]:
        """Return the Gaussians at a time, and numbers [N] by which each is found again at other times."""
        ...

    def __iter__(self) -> Iterator[Gaussians]:
        """Yield the Gaussians at each time."""
        ...


Write = Callable[[Path, Gaussians, Placement], None]


@dataclass(frozen=True)
class FrameFormat:
    """A format of files.

    Attributes:
        suffix: End of the names of its files.
        up: Axis that points up in its files.
        keeps_origin: True if positions far from 0, 0, 0 keep their precision. Other formats leave the origin out.
        marks_antialias: True if its files can mark that points were trained with antialiasing.
    """

    suffix: str
    up: str
    write: Write
    keeps_origin: bool = False
    marks_antialias: bool = True


def _ply(path: Path, points: Gaussians, place: Placement) -> None:
    write_ply(path, turned(points, place.turn), place.shift, place.antialias)


def _compressed_ply(path: Path, points: Gaussians, place: Placement) -> None:
    write_compressed_ply(path, turned(points, place.turn), place.antialias)


def _splat(path: Path, points: Gaussians, place: Placement) -> None:
    write_splat(path, turned(points, place.turn))


def _sog(path: Path, points: Gaussians, place: Placement) -> None:
    write_sog(path, turned(points, place.turn), place.antialias)


def _glb(path: Path, points: Gaussians, place: Placement) -> None:
    write_glb(path, turned(points, place.turn), place.shift)


def _spz(version: Version) -> Write:
    def write(path: Path, points: Gaussians, place: Placement) -> None:
        write_spz(path, turned(points, place.turn), place.antialias, version)

    return write


FRAME_FORMATS: dict[str, FrameFormat] = {
    "ply": FrameFormat(".ply", "-y", _ply, keeps_origin=True),
    "compressed-ply": FrameFormat(".compressed.ply", "-y", _compressed_ply),
    "splat": FrameFormat(".splat", "-y", _splat, marks_antialias=False),
    "sog": FrameFormat(".sog", "-y", _sog),
    "spz": FrameFormat(".spz", "y", _spz(3)),
    "spz2": FrameFormat(".spz", "y", _spz(2)),
    "spz4": FrameFormat(".spz", "y", _spz(4)),
    "glb": FrameFormat(".glb", "y", _glb, keeps_origin=True, marks_antialias=False),
}
"""Formats by the name that `splatreel export --format` takes. Of formats with one suffix, the first is the default."""


def format_of(path: Path) -> str | None:
    """Return the default format of a file by its name; None for another suffix."""
    fits = [name for name, kind in FRAME_FORMATS.items() if path.name.endswith(kind.suffix)]
    return max(fits, key=lambda name: len(FRAME_FORMATS[name].suffix), default=None)


SUFFIXES = (".ply", ".splat", ".ksplat", ".spz", ".sog")
"""Suffixes of files that hold one frame."""
SOG_FOLDERS = (LOD_META, META)
"""Files that make a folder a streamed or an unpacked SOG file."""
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
            columns = read_splat(path, budget)
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
