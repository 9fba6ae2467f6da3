"""Time to Gaussians: what a reel shows at a moment, with the cross-fade between groups (paper section 4.4)."""

from __future__ import annotations

import bisect
from functools import cached_property
from pathlib import Path

import numpy as np

from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.errors import ReelError
from splatreel.play.renderers import Draw, draw_on_cpu
from splatreel.play.sound import ReelSound
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


class Moment(Gaussians):
    """All that a reel shows at a moment. rests: [N] bool, its static points. light: [3], what has brightened all colors.

    fade: where one group fades to the next, what either shows alone, and the weight of the next.
    """

    rests: np.ndarray
    light: np.ndarray
    fade: tuple[Moment, Moment, float] | None

    def __init__(
        self,
        parts: list[Gaussians],
        rests: list[bool],
        light: np.ndarray | None,
        fade: tuple[Moment, Moment, float] | None = None,
    ) -> None:
        """rests: which of the parts do. light: None if it is as ever."""
        everything = _joined(parts if light is None else [part.brightened(light) for part in parts])
        super().__init__(everything.means, everything.quats, everything.scales, everything.opacities, everything.sh)
        object.__setattr__(self, "rests", np.repeat(rests, [len(part) for part in parts]))
        object.__setattr__(self, "light", np.ones(3) if light is None else light)
        object.__setattr__(self, "fade", fade)


class Timeline:
    """A reel in time. Decodes what a moment needs and keeps the groups around it."""

    def __init__(self, reel: ReelReader) -> None:
        self.reel = reel

    @property
    def manifest(self) -> Manifest:
        return self.reel.manifest

    @cached_property
    def sound(self) -> ReelSound | None:
        """None where the reel is silent."""
        sound = self.manifest.presentation.sound
        return ReelSound(self.reel, sound) if sound else None

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

        In the overlap the old group's points fade out and the new one's fade in; what is alive in both stays as it is. `render`
        does better there: it fades pictures.
        Raises `ReelError` for a damaged file or a live reel that has no group yet, ValueError for NaN.
        """
        if np.isnan(seconds):
            raise ValueError("The time is NaN.")
        if not self.manifest.groups:
            raise ReelError(f"{self.reel.name}: holds no group yet. Wait for the first one to be reconstructed.")
        groups, first = self.manifest.groups, self.manifest.first_frame
        frame = float(np.clip(seconds * self.fps, first, max(self.frames - 1, first)))
        place = max(bisect.bisect_right(groups, frame, key=lambda group: group.first_frame) - 1, 0)
        new = self.reel.group(groups[place].group)
        weight = self._weight(frame, new)
        light = new.light_at(frame - new.first_frame)
        if place == 0 or weight >= 1:
            parts = [self.reel.static(new.index)[0][new.alive], new.at(frame - new.first_frame)]
            return Moment(parts, [True, False], light)
        return self._fading(frame, weight, self.reel.group(groups[place - 1].group), new, light)

    def render(self, gaussians: Gaussians, camera: Camera, draw: Draw = draw_on_cpu) -> np.ndarray:
        """The picture that a camera takes of Gaussians of this reel, [H, W, 3] float32, drawn as the manifest says.

        Where one group fades to the next, of a moment it is the pictures of both that fade.
        """
        if isinstance(gaussians, Moment) and gaussians.fade is not None:
            old, new, weight = gaussians.fade
            return (1 - weight) * self.render(old, camera, draw) + weight * self.render(new, camera, draw)
        manifest = self.manifest
        return draw(self.seen(gaussians, camera), camera, manifest.near, manifest.antialias, self.background(gaussians))

    def seen(self, gaussians: Gaussians, camera: Camera) -> Gaussians:
        """What of a moment's Gaussians is drawn for a camera: of static points, what its surroundings leave (`Clearance`)."""
        if not isinstance(gaussians, Moment) or not self.manifest.clearance.share:
            return gaussians
        return gaussians[~(gaussians.rests & self.manifest.clearance.hides(gaussians.means, camera))]

    def background(self, gaussians: Gaussians) -> tuple[float, float, float]:
        """Red, green and blue where nothing is, in a moment's light."""
        light = gaussians.light if isinstance(gaussians, Moment) else 1.0
        red, green, blue = (np.asarray(self.manifest.background) * light).tolist()
        return red, green, blue

    def _weight(self, frame: float, group: Group) -> float:
        overlap = self.manifest.overlap
        share = min((frame - group.first_frame) / overlap, 1.0) if overlap else 1.0
        # Eased: an opaque point in front of the others shows half of its color at a tenth of its weight.
        return share * share * (3 - 2 * share)

    def _fading(self, frame: float, weight: float, old: Group, new: Group, light: np.ndarray | None) -> Moment:
        rested, rests = (self.reel.static(group.index)[0] for group in (old, new))
        living = set(self.manifest.living_layers(new.index))
        shared = [index for index in self.manifest.living_layers(old.index) if index in living]
        in_old, in_new = (self._points_of(shared, group.index) for group in (old, new))
        leaves, comes = old.alive.copy(), new.alive.copy()
        leaves[in_old] &= ~new.alive[in_new]
        comes[in_new] &= ~old.alive[in_old]
        both = rests[new.alive & ~comes]
        leaving = [rested[leaves], old.at(frame - old.first_frame)]
        coming = [rests[comes], new.at(frame - new.first_frame)]
        before, after = (Moment([both, *alone], [True, True, False], light) for alone in (leaving, coming))
        parts = [both, *(p.faded(1 - weight) for p in leaving), *(p.faded(weight) for p in coming)]
        return Moment(parts, [True, True, False, True, False], light, (before, after, weight))

    def _points_of(self, layers: list[int], group: int) -> np.ndarray:
        """[S] bool: which points of the layers that live at a group are of these."""
        living = self.manifest.living_layers(group)
        counts = [self.manifest.layers[index].points for index in living]
        return np.repeat(np.isin(living, layers), counts).astype(bool)


def open_reel(location: str | Path, rendition: str | None = None, most: int | None = None) -> Timeline:
    """Open the reel at a directory, a manifest.json or an http(s) URL; `open_reel(path).at(seconds)` are its Gaussians.

    rendition: one of those the manifest names; None: the best. most: bytes of memory that a file may take, see
    `ReelReader`. Raises `ReelError` if there is no valid reel, or not that rendition.
    """
    return Timeline(ReelReader(location, rendition, most))


def _joined(parts: list[Gaussians]) -> Gaussians:
    return Gaussians.concatenate([p for p in parts if len(p)] or parts[:1])
