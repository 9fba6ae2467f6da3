"""Gaussians of a reel for other programs: rotated and cropped, as a file per frame or as one file of all frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.formats.programs import Program
from splatreel.formats.registry import FRAME_FORMATS, Placement
from splatreel.play.equal_counts import EqualCounts
from splatreel.play.timeline import Timeline
from splatreel.scene.gaussians import Gaussians, turn_upright
from splatreel.scene.volumes import Volume


@dataclass(frozen=True)
class GaussianExport:
    """Gaussians of a reel at some times.

    Attributes:
        seconds: Times, in order.
        up: Unit up direction of the files, [3]; None keeps the axes of the capture.
        crop: Volume to keep, in the reel's coordinates; None keeps all.
        program: Program that the files are for; None for any.
        equal_counts: All frames have the same number of Gaussians in the same order, see `EqualCounts`.
    """

    source: Timeline
    seconds: Sequence[float]
    up: np.ndarray | None
    crop: Volume | None = None
    program: Program | None = None
    equal_counts: bool = False

    @property
    def placement(self) -> Placement:
        """Place of the Gaussians in the axes of the files."""
        manifest = self.source.manifest
        turn = np.array([1.0, 0, 0, 0]) if self.up is None else turn_upright(manifest.up, self.up)
        return Placement(
            turn, manifest.origin if self.keeps_origin and manifest.origin.any() else None, manifest.antialias
        )

    @property
    def keeps_origin(self) -> bool:
        """True if the program reads positions far from 0, 0, 0, or any program is meant."""
        return self.program is None or self.program.reads_double

    def at(self, seconds: float) -> Gaussians:
        """Return the cropped Gaussians at a time, in the axes of the reel. There may be none, before something appears."""
        points: Gaussians = self.source.at(seconds)
        return points if self.crop is None else points[self.crop.contains(points.means)]

    def identified(self, seconds: float) -> tuple[Gaussians, np.ndarray]:
        """Return the cropped Gaussians at a time, and their numbers within the reel, see `Moment.ids`."""
        moment = self.source.at(seconds)
        inside = slice(None) if self.crop is None else self.crop.contains(moment.means)
        return moment[inside], moment.ids[inside]

    def check_content(self) -> None:
        """Raise `ReelError` if there are no Gaussians at any of the times."""
        if any(len(self.at(seconds)) for seconds in self.seconds):
            return
        first, last = self.seconds[0], self.seconds[-1]
        when = f"at {first:.3f} s" if first == last else f"from {first:.3f} to {last:.3f} s"
        if self.crop is not None and any(len(self.source.at(seconds)) for seconds in self.seconds):
            raise ReelError(f"{self.source.reel.name}: no Gaussian {when} is within --crop. Choose another volume.")
        raise ReelError(f"{self.source.reel.name}: shows no Gaussian {when}. Choose another time.")

    def __iter__(self) -> Iterator[Gaussians]:
        """Yield the Gaussians at each time."""
        if self.equal_counts:
            return iter(EqualCounts(self.seconds, self.identified))
        return (self.at(seconds) for seconds in self.seconds)

    def write(self, path: Path, kind: str, points: Gaussians) -> None:
        """Write the Gaussians of one frame in a format of `FRAME_FORMATS`."""
        if self.program is not None and self.program.degree is not None:
            points = points.at_degree(self.program.degree)
        FRAME_FORMATS[kind].write(path, points, self.placement)
