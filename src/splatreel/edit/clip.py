"""Clips: the layers and groups of a reel as a stream that operations change. Nothing is decoded before it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.mp4 import RATE
from splatreel.codec.predictive.precision import Precision
from splatreel.codec.presentation import Limits, Sound, Vec3
from splatreel.codec.reader import ReelReader
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

Read = Callable[[float, float], np.ndarray]
"""Function from start and duration in seconds to samples [n, channels] float32."""


@dataclass(frozen=True)
class SoundPiece:
    """Part of a sound.

    Attributes:
        read: Samples of its source; None for silence.
        seconds: Duration; infinite for the last piece of a sound whose end does not matter.
        start: Time of the source, in seconds, at the piece's beginning.
        backwards: True if time runs backwards in the source.
    """

    read: Read | None
    seconds: float = float("inf")
    start: float = 0.0
    backwards: bool = False

    def part(self, begin: float, seconds: float) -> SoundPiece:
        """Return a part of the piece."""
        start = self.start - begin if self.backwards else self.start + begin
        return replace(self, start=start, seconds=seconds)

    def reversed(self) -> SoundPiece:
        """Return the piece backwards."""
        start = self.start - self.seconds if self.backwards else self.start + self.seconds
        return replace(self, start=start, backwards=not self.backwards)

    def samples(self, begin: float, count: int, channels: int) -> np.ndarray:
        """Return `count` samples from a time on, [count, channels]."""
        if self.read is None or not count:
            return np.zeros((count, channels), np.float32)
        seconds = count / RATE
        start = self.start - begin - seconds if self.backwards else self.start + begin
        found = self.read(start, seconds)
        return np.broadcast_to(found[::-1] if self.backwards else found, (count, channels))


def part_of(pieces: Sequence[SoundPiece], first: float, end: float = float("inf")) -> tuple[SoundPiece, ...]:
    """Return the pieces between two times."""
    parts, begin = [], 0.0
    for piece in pieces:
        low, high = max(first - begin, 0.0), min(end - begin, piece.seconds)
        if low < high:
            parts.append(piece.part(low, high - low))
        begin += piece.seconds
    return tuple(parts)


def padded(pieces: Sequence[SoundPiece], seconds: float) -> tuple[SoundPiece, ...]:
    """Return the pieces up to a time, with silence where they end earlier."""
    parts = part_of(pieces, 0.0, seconds)
    missing = seconds - sum(piece.seconds for piece in parts)
    return (*parts, SoundPiece(None, missing)) if missing > 0 else parts


def _read_pieces(pieces: Sequence[SoundPiece], channels: int, start: float, seconds: float) -> np.ndarray:
    """Return samples [n, channels] of a range of the pieces, with silence after their end."""
    first = round(start * RATE)
    last = first + max(round(seconds * RATE), 0)
    found, begin = [np.zeros((0, channels), np.float32)], 0.0
    for piece in (*pieces, SoundPiece(None)):
        end = begin + piece.seconds
        border = last if end == float("inf") else min(max(round(end * RATE), first), last)
        found.append(piece.samples(first / RATE - begin, border - first, channels))
        first, begin = border, end
        if first == last:
            break
    return np.concatenate(found)


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
        return _read_pieces(self.pieces, self.channels, start, seconds)


@dataclass(frozen=True)
class Outline:
    """Facts of a clip that are known before anything is decoded.

    Attributes:
        name: Name of the reel, for messages.
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


class ChangedClip:
    """Clip that changes what another clip returns. By default nothing changes.

    A long edit is a long chain of such clips. Layers and groups pass through the chain in a loop, so that the depth of
    the call stack does not depend on the number of operations.
    """

    outline: Outline

    def __init__(self, clip: Clip, outline: Outline | None = None) -> None:
        self._clip = clip
        self.outline = clip.outline if outline is None else outline

    def layer_origin(self, index: int) -> tuple[Clip, int]:
        """Return the clip that a layer comes from, and its index there."""
        return self._clip, index

    def group_origin(self, index: int) -> tuple[Clip, int]:
        """Return the clip that a group comes from, and its index there."""
        return self._clip, index

    def change_layer(self, index: int, layer: ClipLayer) -> ClipLayer:
        """Return a layer after the change, from that of its origin."""
        return layer

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group after the change, from that of its origin."""
        return found

    def layer(self, index: int) -> ClipLayer:
        """Return a layer, decoded."""
        chain, clip, at = _origin(self, index, lambda changed, number: changed.layer_origin(number))
        found = clip.layer(at)
        for changed, number in reversed(chain):
            found = changed.change_layer(number, found)
        return found

    def group(self, index: int, rendition: str | None = None) -> ClipGroup:
        """Return a group, decoded; by default the best rendition."""
        chain, clip, at = _origin(self, index, lambda changed, number: changed.group_origin(number))
        found = clip.group(at, rendition)
        for changed, number in reversed(chain):
            found = changed.change_group(number, found)
        return found


def _origin(
    clip: Clip, index: int, origin: Callable[[ChangedClip, int], tuple[Clip, int]]
) -> tuple[list[tuple[ChangedClip, int]], Clip, int]:
    """Return the chain of changes from a clip down, each with the index there, and the unchanged clip with the index there."""
    chain = []
    while isinstance(clip, ChangedClip):
        chain.append((clip, index))
        clip, index = origin(clip, index)
    return chain, clip, index
