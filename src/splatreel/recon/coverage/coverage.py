"""How well cameras cover a scene, and what to expect of new views: told before hours are spent."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch

from splatreel.progress import Progress
from splatreel.recon.coverage.rating import MARKS, rating
from splatreel.recon.coverage.trial import Trial, leave_one_out, shrunk, smaller
from splatreel.recon.init.layout import clearance_of
from splatreel.recon.init.limits import LEAST_DEGREES
from splatreel.recon.init.triangulate import Tracks, triangulate
from splatreel.scene.camera import Camera, angles_apart, focus_point
from splatreel.scene.untrusted import is_number, numbers

WIDTH = 480
"""Pixels across the pictures that points in common are looked for in, at most."""
NEIGHBORS = 6
"""Nearest cameras that each one is compared with."""
FEWEST_SHARED = 20
"""Points that a camera shares with two others, below which it is named."""
SAME = 0.004
"""Of the scene's distance: points this close are one."""
TWIN_DEGREES, TWIN_SHARE = 0.01, 1e-4
"""Cameras that differ by less have the same pose: degrees of rotation, and distance as a share of the scene's."""
NAMED = 6
"""Cameras that a sentence names."""


@dataclass(frozen=True)
class Coverage:
    """names: of the cameras trained on. angles: degrees from each to the nearest other one, seen from the middle of the scene.

    shared: how many points each shows that at least two others show. points: how many there are of these. trial: what came of leaving
    a camera out; None where that was not tried. twins: pairs of names of cameras that have the same pose.
    """

    names: list[str]
    angles: list[float]
    shared: list[int]
    points: int
    trial: Trial | None = None
    twins: list[list[str]] = field(default_factory=list)

    @property
    def angle(self) -> float | None:
        """Degrees from a camera up to which views hold at most, where a trial has failed: it does not tell more."""
        if self.trial is None or self.trial.holds:
            return None
        return round(min(LEAST_DEGREES, self.trial.angle / 2), 2)

    def sentences(self) -> list[str]:
        """What a user reads of it."""
        far, few = int(np.argmax(self.angles)), [c for c, count in enumerate(self.shared) if count < FEWEST_SHARED]
        least, most = f"{min(self.angles):.0f}", f"{max(self.angles):.0f}"
        said = [
            f"cameras are {least if least == most else f'{least} to {most}'} degrees from the nearest other one, seen from the middle "
            f"of the scene ({self.names[far]} is the farthest)",
            f"{self.points:,} points are seen by three cameras or more, and each camera sees {min(self.shared):,} to "
            f"{max(self.shared):,} of them",
        ]
        if few:
            listed = ", ".join(f"{self.names[c]} ({self.shared[c]})" for c in few[:NAMED])
            more = f" and {len(few) - NAMED} more" if len(few) > NAMED else ""
            said.append(f"hardly any points in common with two other cameras: {listed}{more}")
        said += [f"{one} and {other} have the same pose, to all digits that count" for one, other in self.twins]
        return said + self._expected()

    def _expected(self) -> list[str]:
        """What the trial means."""
        if self.trial is None:
            return []
        trial = self.trial
        tried = f"Quick trial without {trial.camera}, {trial.angle:.0f} degrees from the nearest other camera: {trial.psnr:.1f} dB"
        without = f"the nearest camera's picture has {trial.nearest:.1f} dB there, one flat color {trial.flat:.1f} dB"
        remedy = "Set the cameras closer together, or add some between them."
        if not trial.holds:
            return [
                f"{tried}, hardly better than no reconstruction at all ({without}): new views more than {self.angle:.0f} degrees from "
                f"a camera will not be usable. {remedy}"
            ]
        word = rating(trial.psnr)
        found = f"{tried} ({without}). Expect new views between the cameras to be {word}, about {trial.psnr:.0f} dB: {MARKS}."
        return [f"{found} {remedy}" if word == "poor" else found]

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    @staticmethod
    def from_dict(value: dict[str, Any]) -> Coverage:
        """Raises AttributeError, KeyError, TypeError or ValueError for what is none."""
        plain = dict(value)
        trial = plain.pop("trial", None)
        names = plain["names"]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise TypeError("names are no list of texts")
        for field_name in ("angles", "shared"):
            numbers(plain[field_name], len(names))
        if not all(isinstance(name, str) for pair in plain.get("twins", []) for name in pair):
            raise TypeError("twins are no names")
        if trial is not None and not all(is_number(trial[name]) for name in ("angle", "psnr", "flat", "nearest")):
            raise TypeError("a number of the trial is none")
        return Coverage(**plain, trial=None if trial is None else Trial(**trial))


def cover(
    cameras: list[Camera],
    images: np.ndarray,
    *,
    points: np.ndarray | None = None,
    point_colors: np.ndarray | None = None,
    near: float | None = None,
    device: torch.device | None,
    progress: Progress,
) -> Coverage:
    """How cameras cover what they show at a moment. images: [C, H, W, 3] uint8.

    points: [P, 3], point_colors: [P, 3] 0..1 and near: the capture's own, see `initial_points`. device: where a camera is left out for
    trial; None tries nothing.
    """
    small = [smaller(camera, WIDTH) for camera in cameras]
    progress.stage("looking for points that several cameras show", len(cameras))
    shown = np.stack([shrunk(image, camera) for image, camera in zip(images, small, strict=True)])
    tracks = triangulate(small, shown, NEIGHBORS)
    progress.update(len(cameras))
    seen = tracks.points if points is None else np.asarray(points, np.float64)
    focus = np.array(clearance_of(cameras, seen).focus) if len(seen) >= FEWEST_SHARED else focus_point(cameras)
    trial = None
    if device is not None:
        trial = leave_one_out(cameras, shown, focus, points, point_colors, near, device, progress)
    distance = float(np.median([np.linalg.norm(camera.center - focus) for camera in cameras]))
    seen_by = _places(tracks, distance)
    return Coverage(
        [camera.name for camera in cameras],
        [round(float(angle), 2) for angle in angles_apart(cameras, focus).min(1)],
        [int(count) for count in seen_by.sum(0)],
        len(seen_by),
        trial,
        _twins(cameras, distance),
    )


def _places(tracks: Tracks, distance: float) -> np.ndarray:
    """[P, C] bool: which cameras show each place; the same one is found from several cameras. distance: of the scene, world units."""
    cells = np.floor(tracks.points / (SAME * distance)).astype(np.int64)
    _, index = np.unique(cells, axis=0, return_inverse=True)
    index = index.reshape(-1)
    seen = np.zeros((int(index.max(initial=-1)) + 1, tracks.seen.shape[1]), bool)
    np.logical_or.at(seen, index, tracks.seen)
    return seen


def _twins(cameras: list[Camera], distance: float) -> list[list[str]]:
    """Return pairs of names of cameras that have the same pose. distance: of the scene, world units."""
    centers = np.stack([camera.center for camera in cameras]).astype(np.float64)
    turns = np.stack([camera.viewmat[:3, :3] for camera in cameras]).astype(np.float64)
    gaps = np.linalg.norm(centers[:, None] - centers[None], axis=-1)
    apart = np.linalg.norm(turns[:, None] - turns[None], axis=(2, 3)) / np.sqrt(2)  # radians, for small angles
    same = (gaps < TWIN_SHARE * distance) & (apart < np.radians(TWIN_DEGREES))
    return [[cameras[i].name, cameras[j].name] for i, j in zip(*np.nonzero(np.triu(same, 1)), strict=True)]
