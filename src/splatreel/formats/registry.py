"""Formats of files that hold the Gaussians of one frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.formats.compressed_ply import write_compressed_ply
from splatreel.formats.glb import write_glb
from splatreel.formats.ply import write_ply
from splatreel.formats.sog import write_sog
from splatreel.formats.splat import write_splat
from splatreel.formats.spz import Version, write_spz
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.turning import turned


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


Write = Callable[[Path, Gaussians, Placement], None]


@dataclass(frozen=True)
class FrameFormat:
    """A format of files.

    Attributes:
        suffix: End of the names of its files.
        up: Axis that points up in its files.
        write: Function that writes a file.
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


FRAME_FORMATS = {
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
