"""A film as another program wrote it: a set of Gaussians for each frame."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Protocol

import numpy as np

from splatreel.errors import GaussiansError
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.ply import read_ply
from splatreel.sequence.dynamic3dgs import Dynamic3DGS

LOOKED_FOR = """\
  PLY files:            frame0000.ply, frame0001.ply, ..., each as 3DGS writes it; or a numbered folder a frame with one PLY file in it
  Dynamic 3D Gaussians: params.npz"""
_LAST_NUMBER = re.compile(r"^(.*?)([0-9]+)$")


class Frames(Protocol):
    """path: where it was read from. size: bytes on the disk."""

    path: Path
    size: int

    def __len__(self) -> int:
        """How many frames there are."""
        ...

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Those of a frame, counted from 0. Raises `GaussiansError` naming the file where that cannot be read.

        origin: [3] float64, subtracted from all positions before these are rounded to float32; nothing by default.
        """
        ...


class PlyFrames:
    """files: one a frame, in order."""

    def __init__(self, path: Path, files: list[Path]) -> None:
        self.path, self.files = path, files
        self.size = sum(file.stat().st_size for file in files)

    def __len__(self) -> int:
        return len(self.files)

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        return read_ply(self.files[frame], origin)


def open_frames(path: str | Path) -> Frames:
    """Open a folder of numbered PLY files, or a `params.npz` of Dynamic 3D Gaussians or a folder with one.

    Raises `GaussiansError` for anything else, and for files whose order cannot be told.
    """
    place = Path(path)
    archive = place / "params.npz" if place.is_dir() else place
    if archive.suffix == ".npz" and archive.is_file():
        return Dynamic3DGS(archive)
    if not place.is_dir():
        raise GaussiansError(f"{place}: is not a folder; one of these was looked for:\n{LOOKED_FOR}")
    files = sorted(file for file in place.iterdir() if file.suffix.lower() == ".ply" and file.is_file())
    if not files:
        files = [_only_ply(folder) for folder in sorted(place.iterdir()) if folder.is_dir() and _number(folder)]
    if not files:
        raise GaussiansError(f"{place}: holds none of these:\n{LOOKED_FOR}")
    named = {file if file.parent == place else place / file.relative_to(place).parts[0]: file for file in files}
    return PlyFrames(place, [named[name] for name in _in_order(list(named), place)])


def _in_order(names: list[Path], place: Path) -> list[Path]:
    """By the number at the end of each name. Raises `GaussiansError` where one has none, another prefix or the same number."""
    numbers = {name: _number(name) for name in names}
    bare = [name.name for name, number in numbers.items() if number is None]
    if bare and len(names) > 1:
        raise GaussiansError(
            f"{place}: {bare[0]} has no number at its end that says which frame it is. Take it away, or number it."
        )
    prefixes = Counter(number[0] for number in numbers.values() if number)
    if len(prefixes) > 1:
        (usual, _), *_, (odd, _) = prefixes.most_common()
        raise GaussiansError(
            f"{place}: holds files called {usual}N and files called {odd}N. Put each film into a folder of its own."
        )
    counts = Counter(number[1] for number in numbers.values() if number)
    twice = [number for number, count in counts.items() if count > 1]
    if twice:
        raise GaussiansError(f"{place}: holds frame {twice[0]} twice. Take one of the two away.")
    return sorted(names, key=lambda name: (numbers[name] or ("", 0))[1])


def _number(name: Path) -> tuple[str, int] | None:
    """What stands before the number at the end of a name, and the number; None where there is none."""
    found = _LAST_NUMBER.match(name.stem if name.suffix.lower() == ".ply" else name.name)
    return (found[1], int(found[2])) if found else None


def _only_ply(folder: Path) -> Path:
    """The PLY file of a frame's folder, the newest iteration where there are several. Raises `GaussiansError` for none, or a choice."""
    found = sorted(folder.rglob("*.ply"))
    iterations = {number[1]: file for file in found if (number := _number(file.parent))}
    if len(found) > 1 and len(iterations) == len(found):
        return iterations[max(iterations)]
    if len(found) != 1:
        raise GaussiansError(f"{folder}: holds {len(found)} PLY files, where a frame's folder has one.")
    return found[0]
