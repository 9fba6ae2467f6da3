"""Sequences written by other programs: one set of Gaussians per frame."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Protocol

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget
from splatreel.base.untrusted import check_regular, copy_member, naming_damage
from splatreel.formats.fourdgs import FourdgsScene
from splatreel.formats.registry import columns_of, is_antialiased, read_splats, size_of
from splatreel.formats.splat_columns import MANY, Encoding, Remarks, encoding_of
from splatreel.importing.frame_files import Gaps, Order, check_no_checkpoint, find_files, find_members, order_frames
from splatreel.importing.moving_models import Dynamic3DGS, SpacetimeGaussians, is_spacetime
from splatreel.scene.gaussians import Gaussians

OTHER_MARK = "Points are marked differently for antialiasing than those of the first frame, and are drawn as those"
"""Remark on files whose marks differ."""


class Frames(Protocol):
    """Sequence of Gaussians.

    Attributes:
        path: File or folder of the sequence.
        size: Bytes on disk.
        fps: Frames per second, if the sequence states it.
        remarks: What was converted or dropped so far.
    """

    path: Path
    size: int
    fps: float | None
    remarks: Remarks

    def __len__(self) -> int:
        """Return the number of frames."""
        ...

    @property
    def antialias(self) -> bool:
        """True if the points are marked as trained with antialiasing."""
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


class FileFrames:
    """Sequence of files, one per frame in order. A held frame repeats the previous file."""

    def __init__(
        self, path: Path, files: Sequence[Path], fps: float | None = None, budget: MemoryBudget = UNRAISED
    ) -> None:
        self.path = path
        self.files = files
        self.fps = fps
        self.remarks = Remarks()
        self.size = sum(size_of(file) for file in dict.fromkeys(files))
        self._budget = budget
        self._encoding: Encoding | None = None
        self._antialias: bool | None = None

    def __len__(self) -> int:
        return len(self.files)

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Return the Gaussians of a frame."""
        file = self.files[frame]
        points = read_splats(file, origin, self.remarks, self._common_encoding(), self._budget)
        if len(points) and is_antialiased(file, self.remarks) != self.antialias:
            self.remarks.add(OTHER_MARK, file)
        return points

    @property
    def antialias(self) -> bool:
        """True if the first frame marks its points as trained with antialiasing."""
        if self._antialias is None:
            self._antialias = is_antialiased(self.files[0], self.remarks)
        return self._antialias

    def _common_encoding(self) -> Encoding:
        """Return how all PLY files store opacities and scales, judged by the first frame with enough points."""
        if self._encoding is None:
            judged = Encoding()
            for file in self.files:
                columns = columns_of(file, self._budget)
                if columns is None:
                    break
                judged = encoding_of(columns)
                if len(next(iter(columns.values()), ())) >= MANY:
                    break
            self._encoding = judged
        return self._encoding


class ZipFrames:
    """Sequence of files in a zip archive. A frame is unpacked into a temporary folder while it is read."""

    def __init__(self, path: Path, gaps: Gaps = "refuse", budget: MemoryBudget = UNRAISED) -> None:
        self.path = path
        self.size = path.stat().st_size
        self.remarks = Remarks()
        check_regular(path, GaussiansError)
        with naming_damage(str(path), GaussiansError, "not a zip archive, or damaged"):
            self._archive = zipfile.ZipFile(path)
        members = find_members(path, self._archive)
        if not members:
            raise GaussiansError(f"{path}: holds no files of Gaussians (.ply, .splat, .ksplat, .spz or .sog).")
        order = order_frames(list(members), str(path), gaps)
        self.fps = order.fps
        remark_step(order, self.remarks, path)
        self._encoding: Encoding | None = None
        self._antialias: bool | None = None
        self._members = [members[name] for name in order.names]
        self._budget = budget

    def __len__(self) -> int:
        return len(self._members)

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Return the Gaussians of a frame."""
        info = self._members[frame]
        budget = MemoryBudget(self._budget.most, info.compress_size)
        found = Remarks()
        with self._unpacked(info) as file:
            if self._encoding is None and (columns := columns_of(file, budget)) is not None:
                judged = encoding_of(columns)
                self._encoding = judged if len(next(iter(columns.values()), ())) >= MANY else None
            points = read_splats(file, origin, found, self._encoding, budget)
            if len(points) and is_antialiased(file, found) != self.antialias:
                found.add(OTHER_MARK, file)
        self.remarks.take(found, f"{self.path}: {info.filename}")
        return points

    @property
    def antialias(self) -> bool:
        """True if the first frame marks its points as trained with antialiasing."""
        if self._antialias is None:
            found = Remarks()
            with self._unpacked(self._members[0]) as file:
                self._antialias = is_antialiased(file, found)
            self.remarks.take(found, f"{self.path}: {self._members[0].filename}")
        return self._antialias

    @contextmanager
    def _unpacked(self, info: zipfile.ZipInfo) -> Iterator[Path]:
        """Unpack a member into a temporary file. Errors about that file name the archive and the member."""
        budget, source = MemoryBudget(self._budget.most, info.compress_size), f"{self.path}: {info.filename}"
        budget.check(info.file_size, info.compress_size, source, f"{info.file_size:,} unpacked bytes")
        with tempfile.TemporaryDirectory() as folder:
            # The file does not bear the name of the member, which can be too long.
            file = Path(folder) / f"frame{PurePosixPath(info.filename).suffix.lower()}"
            with naming_damage(source, GaussiansError), file.open("wb") as target:
                copy_member(self._archive, info, target)
            try:
                yield file
            except GaussiansError as error:
                raise GaussiansError(str(error).replace(str(file), source)) from error


def open_files(place: Path, gaps: Gaps, budget: MemoryBudget = UNRAISED) -> FileFrames | None:
    """Open a file of Gaussians, or a folder of them. Return None if there are none.

    Args:
        place: The file or folder.
        gaps: Treatment of missing frame numbers.
        budget: Memory that reading a frame may take.

    Raises:
        GaussiansError: The order of the files is unclear, or frames are missing.
    """
    named = find_files(place)
    if not named:
        return None
    order = order_frames(list(named), str(place), gaps)
    frames = FileFrames(place, [named[name] for name in order.names], order.fps, budget)
    remark_step(order, frames.remarks, place)
    return frames


def remark_step(order: Order, remarks: Remarks, place: Path) -> None:
    """Remark on numbers that do not count by one."""
    if order.step != 1 and len(order.names) > 1:
        remarks.add(f"Numbers of files go up by {order.step:g}: they were taken as consecutive frames", place)


INPUT = "input.ply"
"""Copy of the first points that 3DGS's code leaves in the folder of a training."""
LOOKED_FOR = """\
  files of Gaussians:   frame0000.ply, frame0001.ply, ..., or .splat, .ksplat, .spz, .sog files;
                        or a numbered folder a frame with one file in it
  streamed SOG:         lod-meta.json
  one such file:        point_cloud.ply, scene.spz, ...
  zip archive:          of such files
  Dynamic 3D Gaussians: params.npz
  SpacetimeGaussians:   point_cloud.ply of a lite model, with its cfg_args
  4dgs:                 scene.4dgs"""


def open_frames(
    path: str | Path,
    gaps: Gaps = "refuse",
    fps: float | None = None,
    length: int | None = None,
    most: int | None = None,
) -> Frames:
    """Open a sequence of Gaussians: a folder, an archive or a single file.

    Args:
        path: Folder or file.
        gaps: Treatment of missing frame numbers.
        fps: Samples per second of a scene that is continuous in time; None takes its own.
        length: Number of frames of a model that does not state it.
        most: Memory in bytes that reading a file may take; None limits each file in proportion to its length.

    Raises:
        GaussiansError: The path is anything else, the order of the files is unclear, or frames are missing.
    """
    place = Path(path)
    found = _open(place, gaps, fps, length, MemoryBudget(most))
    if length is not None and not isinstance(found, SpacetimeGaussians):
        raise GaussiansError(f"{place}: has {len(found)} frames of its own. Leave out --length, or name a model.")
    return found


def _open(place: Path, gaps: Gaps, fps: float | None, length: int | None, budget: MemoryBudget) -> Frames:
    archive = place / "params.npz" if place.is_dir() else place
    if archive.suffix.lower() == ".npz" and archive.is_file():
        return Dynamic3DGS(archive, budget)
    if place.suffix.lower() == ".zip" and place.is_file():
        return ZipFrames(place, gaps, budget)
    if place.suffix.lower() == ".4dgs" and place.is_file():
        return FourdgsScene(place, fps, budget)
    if not place.exists():
        raise GaussiansError(f"{place}: does not exist. One of these was looked for:\n{LOOKED_FOR}")
    if (place.is_dir() or place.is_file()) and (found := open_files(place, gaps, budget)):
        one = found.files[0]
        if len(found) == 1 and one.name == INPUT:
            check_no_checkpoint(place)
        return SpacetimeGaussians(one, length, budget) if len(found) == 1 and is_spacetime(one, budget) else found
    if place.is_dir():
        check_no_checkpoint(place)
    raise GaussiansError(
        f"{place}: holds none of these:\n{LOOKED_FOR}"
        if place.is_dir()
        else f"{place}: is none of these:\n{LOOKED_FOR}"
    )
