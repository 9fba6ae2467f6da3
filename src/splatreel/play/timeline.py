"""Time to Gaussians: what a reel shows at a moment, with the cross-fade between groups (paper section 4.4)."""

from __future__ import annotations

import bisect
from pathlib import Path

import numpy as np

from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.errors import ReelError
from splatreel.kernels.image import render_image
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


class Moment(Gaussians):
    """All that a reel shows at a moment. still: so many points rest, the first ones. light: [3], what has brightened all colours."""

    still: int
    light: np.ndarray

    def __init__(self, static: list[Gaussians], moving: list[Gaussians], light: np.ndarray) -> None:
        everything = _joined([*static, *moving])
        super().__init__(everything.means, everything.quats, everything.scales, everything.opacities, everything.sh)
        object.__setattr__(self, "still", sum(len(part) for part in static))
        object.__setattr__(self, "light", light)


class Timeline:
    """A reel in time. Decodes what a moment needs and keeps the groups around it."""

    def __init__(self, reel: ReelReader) -> None:
        self.reel = reel

    @property
    def manifest(self) -> Manifest:
        return self.reel.manifest

    @property
    def fps(self) -> float:
        return self.reel.fps

    @property
    def frames(self) -> int:
        return self.reel.frames

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.reel.duration

    def at(self, seconds: float) -> Moment:
        """Everything visible at a time, ready to render; times outside of the reel are clamped.

        In the overlap the old group's points fade out and the new one's fade in; what is alive in both stays as it is.
        Raises `ReelError` for a damaged file or a live reel that has no group yet, ValueError for NaN.
        """
        if np.isnan(seconds):
            raise ValueError("The time is NaN.")
        if not self.manifest.groups:
            raise ReelError(f"{self.reel.name}: holds no group yet. Wait for the first one to be reconstructed.")
        frame = float(np.clip(seconds * self.fps, 0, self.frames - 1))
        index = max(bisect.bisect_right([g.first_frame for g in self.manifest.groups], frame) - 1, 0)
        new = self.reel.group(index)
        weight = self._weight(frame, new)
        if index == 0 or weight >= 1:
            static, moving = [self.reel.static(index)[0][new.alive]], [new.at(frame - new.first_frame)]
        else:
            static, moving = self._faded(frame, weight, self.reel.group(index - 1), new)
        light = new.light_at(frame - new.first_frame)
        if light is None:
            return Moment(static, moving, np.ones(3))
        static, moving = ([part.brightened(light) for part in parts] for parts in (static, moving))
        return Moment(static, moving, light)

    def seen(self, gaussians: Gaussians, camera: Camera) -> Gaussians:
        """What of a moment's Gaussians is drawn for a camera: of static points, what its surroundings leave (`Clearance`)."""
        if not isinstance(gaussians, Moment) or not self.manifest.clearance.share:
            return gaussians
        shown = np.ones(len(gaussians), bool)
        shown[: gaussians.still] = ~self.manifest.clearance.hides(gaussians.means[: gaussians.still], camera)
        return gaussians[shown]

    def render(self, gaussians: Gaussians, camera: Camera) -> np.ndarray:
        """The picture that a camera takes of Gaussians of this reel, [H, W, 3] float32, drawn as the manifest says."""
        how = {
            "near": self.manifest.near,
            "antialias": self.manifest.antialias,
            "background": self.background(gaussians),
        }
        return render_image(self.seen(gaussians, camera), camera, **how)

    def background(self, gaussians: Gaussians) -> tuple[float, float, float]:
        """Red, green and blue where nothing is, in a moment's light."""
        light = gaussians.light if isinstance(gaussians, Moment) else 1.0
        red, green, blue = (np.asarray(self.manifest.background) * light).tolist()
        return red, green, blue

    def _weight(self, frame: float, group: Group) -> float:
        overlap = self.manifest.overlap
        share = min((frame - group.first_frame) / overlap, 1.0) if overlap else 1.0
        # Eased: an opaque point in front of the others shows half of its colour at a tenth of its weight.
        return share * share * (3 - 2 * share)

    def _faded(self, frame: float, weight: float, old: Group, new: Group) -> tuple[list[Gaussians], list[Gaussians]]:
        """Static points and moving ones."""
        static, _ = self.reel.static(new.index)
        was = np.zeros(len(static), bool)
        was[: len(old.alive)] = old.alive  # layers only append: the old group's points are the first ones
        leaving, coming = static[was & ~new.alive].faded(1 - weight), static[new.alive & ~was].faded(weight)
        moving = [
            old.at(frame - old.first_frame).faded(1 - weight),
            new.at(frame - new.first_frame).faded(weight),
        ]
        return [static[was & new.alive], leaving, coming], moving


def open_reel(location: str | Path, rendition: str | None = None) -> Timeline:
    """Open the reel at a directory, a manifest.json or an http(s) URL; `open_reel(path).at(seconds)` are its Gaussians.

    rendition: one of those the manifest names; None: the best. Raises `ReelError` if there is no valid reel, or not that rendition.
    """
    return Timeline(ReelReader(location, rendition))


def _joined(parts: list[Gaussians]) -> Gaussians:
    return Gaussians.concatenate([p for p in parts if len(p)] or parts[:1])
