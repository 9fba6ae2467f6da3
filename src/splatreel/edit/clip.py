"""Clips: the layers and groups of a reel as a stream that operations change. Nothing is decoded before it is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.predictive.precision import Precision
from splatreel.codec.presentation import Limits, Sound, Vec3
from splatreel.codec.reader import ReelReader
from splatreel.edit.sound_pieces import SoundPiece, read_pieces
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


@dataclass(frozen=True)
class LayerSpan:
    """Groups at which a layer lives: from `born` to before `until`, or to the end."""

    born: int
    until: int | None = None

    def lives_at(self, group: int) -> bool:
        """Return whether a group can show this layer."""
        return self.born <= group and (self.until is None or group < self.until)


@dataclass(frozen=True)
class ClipSpan:
    """Frames of a group, and those over which it cross-fades with the group before (0 is a hard cut)."""

    first_frame: int
    frames: int
    overlap: int

    @property
    def end(self) -> int:
        """Frame after the group's last frame."""
        return self.first_frame + self.frames


@dataclass(frozen=True)
class ClipSound:
    """Sound of a clip.

    Attributes:
        channels: 1 or 2.
        position: Position of the source, world units; None if it has none.
        pieces: Parts of the sound, one after the other.
        files: Reel that has exactly this sound, and its description; None if the samples must be encoded.
    """

    channels: int
    position: Vec3 | None
    pieces: tuple[SoundPiece, ...]
    files: tuple[ReelReader, Sound] | None = None

    def read(self, start: float, seconds: float) -> np.ndarray:
        """Return samples [n, channels] float32, from a start and a duration in seconds."""
        return read_pieces(self.pieces, self.channels, start, seconds)


@dataclass(frozen=True)
class Outline:
    """Facts of a clip that are known before anything is decoded.

    Attributes:
        name: Name of the reel, for messages.
        header: Header of the reel.
        limits: Limits of the views.
        texts: Title, author, description and license.
        renditions: Names of the renditions, best first; empty for one.
        layers: Spans of the layers, in any order.
        groups: Spans of the groups, in order of time from frame 0 on.
        sound: The sound; None for a silent clip.
    """

    name: str
    header: ReelHeader
    limits: Limits | None
    texts: Mapping[str, str]
    renditions: tuple[str, ...]
    layers: tuple[LayerSpan, ...]
    groups: tuple[ClipSpan, ...]
    sound: ClipSound | None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return max(group.end for group in self.groups)

    @property
    def seconds(self) -> float:
        """Duration in seconds."""
        return self.frames / self.header.fps

    def with_source(self, frames: int | None) -> Outline:
        """Return the outline of a clip that starts at a later frame of this one, or that has other frames (None)."""
        source = self.header.source
        if source is not None:
            source = replace(source, frame=None) if frames is None else source.shifted(frames)
        return replace(self, header=replace(self.header, source=source))

    @property
    def focus(self) -> np.ndarray:
        """Point that the cameras look at, [3]: that of the limits, or the middle of the bounds."""
        return self.header.bounds.mean(0) if self.limits is None else np.array(self.limits.focus)

    def living(self, group: int) -> list[int]:
        """Return the indices of the layers that live at a group."""
        return [index for index, layer in enumerate(self.layers) if layer.lives_at(group)]


@dataclass(frozen=True)
class ClipLayer:
    """Static points of a layer, and their precision; None chooses one."""

    points: Gaussians
    precision: Precision | None

    def __getitem__(self, index: np.ndarray) -> ClipLayer:
        """Return the layer with some of its points."""
        return ClipLayer(self.points[index], None if self.precision is None else self.precision[index])


@dataclass(frozen=True)
class ClipGroup:
    """Group of a clip.

    Attributes:
        group: The group. Its numbers, its first frame and its alive flags are not used.
        alive: Points of each living layer that the group shows, [S] bool by index of the layer.
        precision: Precision of the dynamic points; None chooses one.
    """

    group: Group
    alive: Mapping[int, np.ndarray]
    precision: Precision | None

    def __getitem__(self, index: np.ndarray) -> ClipGroup:
        """Return the group with some of its dynamic points."""
        group = self.group
        some = replace(
            group,
            dynamic=group.dynamic[index],
            dx=group.dx[:, index],
            dq=group.dq[:, index],
            shade=None if group.shade is None else group.shade[:, index],
        )
        return replace(self, group=some, precision=None if self.precision is None else self.precision[index])

    def with_motion(
        self, dx: np.ndarray, dq: np.ndarray, shade: np.ndarray | None, light: np.ndarray | None
    ) -> ClipGroup:
        """Return the group with other frames. New bases are found for them."""
        precision = self.precision and self.precision.without_bases("dx", "dq", "shade")
        return replace(self, group=replace(self.group, dx=dx, dq=dq, shade=shade, light=light), precision=precision)

    def opacities(self) -> np.ndarray:
        """Return the opacities of the dynamic points at each frame, [T, N], clamped to 0..1."""
        group = self.group
        still = np.broadcast_to(group.dynamic.opacities, group.dx.shape[:2])
        return still if group.shade is None else np.clip(still + group.shade[..., 3], 0, 1)


class Clip(Protocol):
    """Source of layers and groups. An operation is a clip that changes what another clip returns."""

    outline: Outline

    def layer(self, index: int) -> ClipLayer:
        """Return a layer, decoded."""
        ...

    def group(self, index: int, rendition: str | None = None) -> ClipGroup:
        """Return a group, decoded; by default the best rendition."""
        ...


def shown_points(clip: Clip, index: int, frame: float) -> tuple[Gaussians, dict[int, slice], slice]:
    """Return all points that a group shows at one of its frames, where the points of each layer are, and the dynamic points."""
    found, places, parts, start = clip.group(index), {}, [], 0
    for layer, flags in found.alive.items():
        parts.append(clip.layer(layer).points[flags])
        places[layer] = slice(start, start + len(parts[-1]))
        start += len(parts[-1])
    parts.append(found.group.at(frame))
    return Gaussians.concatenate(parts), places, slice(start, start + len(parts[-1]))
