"""Sequences written by other programs: one set of Gaussians per frame."""

from __future__ import annotations

import math
import re
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from splatreel.errors import GaussiansError
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.ply import read_ply
from splatreel.sequence.dynamic3dgs import Dynamic3DGS
from splatreel.sequence.plausible import check_plausible

LOOKED_FOR = """\
  PLY files:            frame0000.ply, frame0001.ply, ..., each as 3DGS writes it; or a numbered folder a frame with one PLY file in it
  Dynamic 3D Gaussians: params.npz"""
Gaps = Literal["refuse", "hold"]
"""Treatment of missing frame numbers: refuse the sequence, or hold the previous frame."""
MOST_FRAMES = 1_000_000
"""Maximum number of frames, including held ones."""
_LAST_NUMBER = re.compile(r"^(.*?)([0-9]+)$")


class Frames(Protocol):
    """Sequence of Gaussians.

    Attributes:
        path: File or folder of the sequence.
        size: Bytes on disk.
    """

    path: Path
    size: int

    def __len__(self) -> int:
        """Return the number of frames."""
        ...

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Return the Gaussians of a frame.

        Args:
            frame: Number of the frame, from 0.
            origin: Point subtracted from all positions before rounding to float32, [3] float64; None subtracts nothing.

        Raises:
            GaussiansError: The frame cannot be read. The message names the file.
        """
        ...


class PlyFrames:
    """Sequence of PLY files, one per frame in order. A held frame repeats the previous file."""

    def __init__(self, path: Path, files: list[Path]) -> None:
        self.path, self.files = path, files
        self.size = sum(file.stat().st_size for file in dict.fromkeys(files))

    def __len__(self) -> int:
        return len(self.files)

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Return the Gaussians of a frame."""
        file = self.files[frame]
        return check_plausible(read_ply(file, origin), str(file))


def open_frames(path: str | Path, gaps: Gaps = "refuse") -> Frames:
    """Open a folder of numbered PLY files, or a `params.npz` of Dynamic 3D Gaussians, or a folder with one.

    Raises:
        GaussiansError: The path is anything else, the order of the files is unclear, or frames are missing.
    """
    place = Path(path)
    archive = place / "params.npz" if place.is_dir() else place
    if archive.suffix == ".npz" and archive.is_file():
        return Dynamic3DGS(archive)
    if not place.is_dir():
        raise GaussiansError(f"{place}: is not a folder; one of these was looked for:\n{LOOKED_FOR}")
    files = sorted(file for file in place.iterdir() if file.suffix.lower() == ".ply" and not file.name.startswith("."))
    if odd := next((file for file in files if not file.is_file()), None):
        raise _not_a_file_error(odd)
    if not files:
        folders = [folder for folder in sorted(place.iterdir()) if _split_number(folder) and not folder.is_file()]
        if any(folder.is_dir() for folder in folders) and (odd := next((f for f in folders if not f.is_dir()), None)):
            raise _not_a_file_error(odd)
        files = [_only_ply(folder) for folder in folders]
    if not files:
        raise GaussiansError(f"{place}: holds none of these:\n{LOOKED_FOR}")
    named = {file if file.parent == place else place / file.relative_to(place).parts[0]: file for file in files}
    order = _in_order(list(named), place)
    held = _without_gaps(order, place, gaps)
    return PlyFrames(place, [named[name] for name in held])


def _not_a_file_error(path: Path) -> GaussiansError:
    what = "a link to nothing" if path.is_symlink() and not path.exists() else "no file"
    return GaussiansError(f"{path}: is {what}, so a frame is missing. Add the file, or remove the entry.")


def _without_gaps(names: list[Path], place: Path, gaps: Gaps) -> list[Path]:
    """Return names in order, with the previous name repeated for each missing number. A constant step between numbers is no gap.

    Raises:
        GaussiansError: There are gaps and `gaps` is "refuse".
    """
    numbers = [number[1] for name in names if (number := _split_number(name))]
    steps = [after - before for before, after in pairwise(numbers)]
    if len(set(steps)) <= 1:
        return names
    step = math.gcd(*steps)
    first = next(i for i, gap in enumerate(steps) if gap > step)
    missing = sum(gap // step - 1 for gap in steps)
    if gaps != "hold":
        raise GaussiansError(
            f"{place}: {missing:,} frames are missing, the first of them after {names[first].name}: the next one is "
            f"{names[first + 1].name}. Add them, or import with --gaps hold, which repeats the previous frame."
        )
    if len(names) + missing > MOST_FRAMES:
        raise GaussiansError(
            f"{place}: with {missing:,} frames held it would have more than {MOST_FRAMES:,}. Renumber its files."
        )
    return [name for name, gap in zip(names, [*steps, step], strict=True) for _ in range(gap // step)]


def _in_order(names: list[Path], place: Path) -> list[Path]:
    """Sort names by the number at their end.

    Raises:
        GaussiansError: A name has no number, another prefix, or a number that another name has.
    """
    numbers = {name: _split_number(name) for name in names}
    bare = [name.name for name, number in numbers.items() if number is None]
    if bare and len(names) > 1:
        raise GaussiansError(
            f"{place}: {bare[0]} has no number at its end that says which frame it is. Remove it, or number it."
        )
    prefixes = Counter(number[0] for number in numbers.values() if number)
    if len(prefixes) > 1:
        (usual, _), *_, (odd, _) = prefixes.most_common()
        raise GaussiansError(
            f"{place}: holds files called {usual}N and files called {odd}N. Put each sequence into its own folder."
        )
    counts = Counter(number[1] for number in numbers.values() if number)
    twice = [number for number, count in counts.items() if count > 1]
    if twice:
        raise GaussiansError(f"{place}: holds frame {twice[0]} twice. Remove one of them.")
    return sorted(names, key=lambda name: (numbers[name] or ("", 0))[1])


def _split_number(name: Path) -> tuple[str, int] | None:
    """Return the text before the number at the end of a name, and the number; None without a number."""
    found = _LAST_NUMBER.match(name.stem if name.suffix.lower() == ".ply" else name.name)
    return (found[1], int(found[2])) if found else None


def _only_ply(folder: Path) -> Path:
    """Return the PLY file of a frame's folder, the newest iteration if there are several.

    Raises:
        GaussiansError: There is no file, or the choice is unclear.
    """
    found = sorted(folder.rglob("*.ply"))
    iterations = {number[1]: file for file in found if (number := _split_number(file.parent))}
    if len(found) > 1 and len(iterations) == len(found):
        return iterations[max(iterations)]
    if len(found) != 1:
        raise GaussiansError(f"{folder}: holds {len(found)} PLY files, where a frame's folder has one.")
    return found[0]
