"""The Gaussians of a reel at any time, with the cross-fade between groups.

Source: paper section 4.4.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, overload

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader, find_reel
from splatreel.kernels.image import render_image
from splatreel.play.reel_sound import ReelSound
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

if TYPE_CHECKING:
    import torch

Color = tuple[float, float, float]
Draw = Callable[[Gaussians, Camera, float, bool, Color], np.ndarray]
"""Function of (Gaussians, camera, near plane in world units, antialias, background) that returns an image.

The image is [H, W, 3] float32, whose values may exceed 1.
"""


_ROWS, _GROUPS = 32, 1 << 62
"""Bits of an id for the number of a Gaussian in its layer or group, and the bit of those in groups."""


def draw_on_cpu(gaussians: Gaussians, camera: Camera, near: float, antialias: bool, background: Color) -> np.ndarray:
    """Render on the CPU, see `Draw`."""
    return render_image(gaussians, camera, near=near, antialias=antialias, background=background)


class Part(NamedTuple):
    """Gaussians that are all static or all dynamic, with their ids."""

    points: Gaussians
    is_static: bool
    ids: np.ndarray


@dataclass(frozen=True, repr=False)
class Moment(Gaussians):
    """The Gaussians that a reel shows at a time.

    Attributes:
        is_static: [N] bool: which Gaussians are static.
        ids: [N] int64: number of each Gaussian within the reel. A dynamic one keeps it within its group, a static one within its layer.
        light: [3] factors by which all colors were multiplied.
        fade: In a cross-fade, the Gaussians of the old and of the new group alone, and the weight of the new one; otherwise None.
    """

    is_static: np.ndarray
    ids: np.ndarray
    light: np.ndarray
    fade: tuple[Moment, Moment, float] | None = None

    @staticmethod
    def join(
        parts: list[Part],
        light: np.ndarray | None,
        fade: tuple[Moment, Moment, float] | None = None,
    ) -> Moment:
        """Join sets of Gaussians.

        Args:
            parts: Sets of Gaussians.
            light: [3] factors of all colors; None for constant light.
            fade: See `Moment`.
        """
        sets = [part.points if light is None else part.points.brightened(light) for part in parts]
        joined = Gaussians.concatenate([points for points in sets if len(points)] or sets[:1])
        is_static = np.repeat([part.is_static for part in parts], [len(points) for points in sets])
        return Moment(
            means=joined.means,
            quats=joined.quats,
            scales=joined.scales,
            opacities=joined.opacities,
            sh=joined.sh,
            is_static=is_static,
            ids=np.concatenate([part.ids for part in parts]),
            light=np.ones(3) if light is None else light,
            fade=fade,
        )


class Timeline:
    """A reel as a function of time, and as a sequence of frames. It decodes the groups that are needed, and caches them.

    `with open_reel(path) as reel:` drops the decoded groups at the end. In a live reel that dropped its oldest frames, frame 0 is the
    first one that it still has.
    """

    def __init__(self, reel: ReelReader) -> None:
        """Play the reel of a reader."""
        self.reel = reel

    def __repr__(self) -> str:
        """Return name, frames, rate and duration."""
        return f"Timeline({self.reel.folder!r}, {len(self)} frames at {self.fps:g} a second, {self.duration:.2f} s)"

    def __len__(self) -> int:
        """Return the number of frames."""
        return max(self.frames - self.manifest.first_frame, 0)

    @overload
    def __getitem__(self, index: int) -> Moment: ...

    @overload
    def __getitem__(self, index: slice) -> list[Moment]: ...

    def __getitem__(self, index: int | slice) -> Moment | list[Moment]:
        """Return the Gaussians of a frame, or of several. Negative numbers count from the end.

        Raises:
            IndexError: There is no such frame.
        """
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(len(self)))]
        number = index + len(self) if index < 0 else index
        if not 0 <= number < len(self):
            raise IndexError(f"There is no frame {index}: {self.reel.folder} has {len(self)} frames.")
        return self._at_frame(float(self.manifest.first_frame + number))

    def __iter__(self) -> Iterator[Moment]:
        """Return the Gaussians of one frame after the other."""
        return (self[number] for number in range(len(self)))

    def __enter__(self) -> Timeline:
        """Return the reel."""
        return self

    def __exit__(self, *_: object) -> None:
        """Drop the decoded groups."""
        self.close()

    def close(self) -> None:
        """Drop the decoded groups. Later calls decode them again."""
        self.reel.forget()

    @property
    def manifest(self) -> Manifest:
        """Manifest of the reel."""
        return self.reel.manifest

    @cached_property
    def sound(self) -> ReelSound | None:
        """Sound of the reel; None for a silent one."""
        sound = self.manifest.presentation.sound
        return ReelSound(self.reel, sound) if sound else None

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self.reel.fps

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.reel.frames

    @property
    def duration(self) -> float:
        """Duration in seconds."""
        return self.reel.duration

    def at(self, seconds: float) -> Moment:
        """Return the Gaussians at a time, which is clamped to the reel.

        In the overlap of two groups, the points of the old group fade out and those of the new one fade in. Static points alive in both
        do not change. `render` blends images there instead, which looks better.

        Raises:
            ReelError: A file is damaged, or a live reel has no group yet.
            ValueError: The time is NaN.
        """
        if np.isnan(seconds):
            raise ValueError("The time is NaN.")
        if not self.manifest.groups:
            raise ReelError(f"{self.reel.name}: holds no group yet. Wait for the first one to be reconstructed.")
        first = self.manifest.first_frame
        return self._at_frame(float(np.clip(seconds * self.fps, first, max(self.frames - 1, first))))

    def to_torch(self, seconds: float, device: str | torch.device = "cpu") -> dict[str, torch.Tensor]:
        """Return the Gaussians at a time as tensors, see `at` and `Gaussians.to_torch`."""
        return self.at(seconds).to_torch(device)

    def _at_frame(self, frame: float) -> Moment:
        """Return the Gaussians at a frame within the reel, with the near plane of the manifest."""
        return replace(self._moment(frame), near=self.manifest.near)

    def groups_at(self, frame: float) -> list[tuple[Group, float]]:
        """Return the groups that show at a frame of the reel, each with its weight: one, or in an overlap the old and the new group."""
        groups = self.manifest.groups
        place = max(bisect.bisect_right(groups, frame, key=lambda group: group.first_frame) - 1, 0)
        new = self.reel.group(groups[place].group)
        weight = self._weight(frame, new)
        if place == 0 or weight >= 1:
            return [(new, 1.0)]
        return [(self.reel.group(groups[place - 1].group), 1 - weight), (new, weight)]

    def _moment(self, frame: float) -> Moment:
        shown = self.groups_at(frame)
        new, weight = shown[-1]
        light = new.light_at(frame - new.first_frame)
        if len(shown) == 1:
            return Moment.join([self._static(new.index, new.alive), _dynamic(new, frame)], light)
        return self._fading(frame, weight, shown[0][0], new, light)

    def render(self, gaussians: Gaussians, camera: Camera, draw: Draw = draw_on_cpu) -> np.ndarray:
        """Render Gaussians of this reel with the near plane, antialiasing and background of its manifest.

        A `Moment` in a cross-fade is rendered as a blend of two images, one per group.

        The first call compiles the kernels if they are not in the cache yet. A line of the logger `splatreel` says so.

        Returns:
            [H, W, 3] float32, sRGB, 0..1.
        """
        return np.clip(self._render(gaussians, camera, draw), 0, 1)

    def _render(self, gaussians: Gaussians, camera: Camera, draw: Draw) -> np.ndarray:
        if isinstance(gaussians, Moment) and gaussians.fade is not None:
            old, new, weight = gaussians.fade
            return (1 - weight) * self._render(old, camera, draw) + weight * self._render(new, camera, draw)
        manifest = self.manifest
        return draw(self.seen(gaussians, camera), camera, manifest.near, manifest.antialias, self.background(gaussians))

    def seen(self, gaussians: Gaussians, camera: Camera) -> Gaussians:
        """Return the Gaussians to draw for a camera: without the static ones that its `Clearance` hides."""
        if not isinstance(gaussians, Moment) or not self.manifest.clearance.share:
            return gaussians
        return gaussians[~(gaussians.is_static & self.manifest.clearance.hides(gaussians.means, camera))]

    def background(self, gaussians: Gaussians) -> tuple[float, float, float]:
        """Return the background color, red, green and blue, scaled by the light of a moment."""
        light = gaussians.light if isinstance(gaussians, Moment) else 1.0
        red, green, blue = (np.asarray(self.manifest.background) * light).tolist()
        return red, green, blue

    def _weight(self, frame: float, group: Group) -> float:
        own = self.manifest.group_entry(group.index).overlap
        overlap = self.manifest.overlap if own is None else own
        share = min((frame - group.first_frame) / overlap, 1.0) if overlap else 1.0
        # Eased, since an opaque point in front of others shows half of its color at a tenth of its weight.
        return share * share * (3 - 2 * share)

    def _fading(self, frame: float, weight: float, old: Group, new: Group, light: np.ndarray | None) -> Moment:
        living = set(self.manifest.living_layers(new.index))
        shared = [index for index in self.manifest.living_layers(old.index) if index in living]
        in_old, in_new = (self._points_of(shared, group.index) for group in (old, new))
        leaves, comes = old.alive.copy(), new.alive.copy()
        leaves[in_old] &= ~new.alive[in_new]
        comes[in_new] &= ~old.alive[in_old]
        both = self._static(new.index, new.alive & ~comes)
        leaving = [self._static(old.index, leaves), _dynamic(old, frame)]
        coming = [self._static(new.index, comes), _dynamic(new, frame)]
        before, after = Moment.join([both, *leaving], light), Moment.join([both, *coming], light)
        faded = [
            part._replace(points=part.points.faded(share))
            for parts, share in ((leaving, 1 - weight), (coming, weight))
            for part in parts
        ]
        return Moment.join([both, *faded], light, (before, after, weight))

    def _static(self, group: int, shown: np.ndarray) -> Part:
        """Return some static points of a group, as a mask of all in its layers."""
        layers = self.manifest.living_layers(group)
        counts = [self.manifest.layers[index].points for index in layers]
        ids = [(index << _ROWS) + np.arange(count) for index, count in zip(layers, counts, strict=True)]
        return Part(self.reel.static(group)[0][shown], True, np.concatenate([np.zeros(0, np.int64), *ids])[shown])

    def _points_of(self, layers: list[int], group: int) -> np.ndarray:
        """Return which static points of a group belong to `layers`, [S] bool."""
        living = self.manifest.living_layers(group)
        counts = [self.manifest.layers[index].points for index in living]
        return np.repeat(np.isin(living, layers), counts).astype(bool)


def _dynamic(group: Group, frame: float) -> Part:
    """Return the dynamic points of a group at a frame of the reel."""
    points = group.at(frame - group.first_frame)
    return Part(points, False, _GROUPS + (group.index << _ROWS) + np.arange(len(points)))


def open_reel(location: str | Path, rendition: str | None = None, most: int | None = None) -> Timeline:
    """Open a reel. `open_reel(path).at(seconds)` returns its Gaussians.

    Args:
        location: Directory, manifest.json or http(s) URL; also the output folder OUT of `reconstruct`.
        rendition: One of those that the manifest names; None for the best.
        most: Bytes of memory that a file may take, see `ReelReader`.

    Raises:
        ReelError: There is no valid reel, or not that rendition.
    """
    return Timeline(ReelReader(find_reel(location), rendition, most))
