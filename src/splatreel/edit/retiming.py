"""Changes of time: a part of a clip, a clip backwards, another frame rate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from splatreel.edit.clip import ChangedClip, Clip, ClipGroup, ClipSpan, LayerSpan, padded, part_of
from splatreel.scene import rotations


class Cut(ChangedClip):
    """Frames `first` to `end` - 1 of a clip.

    The clip starts with one group. If `first` lies in a cross-fade, the part starts with the newer group alone.
    """

    def __init__(self, clip: Clip, first: int, end: int) -> None:
        super().__init__(clip)
        source = clip.outline
        spans = source.groups
        self._begin = max(index for index, span in enumerate(spans) if span.first_frame <= first)
        last = max(index for index, span in enumerate(spans) if span.first_frame < end)
        chosen = spans[self._begin : last + 1]
        self._ranges = [(max(span.first_frame, first), min(span.end, end)) for span in chosen]
        groups = [
            ClipSpan(begin - first, stop - begin, span.overlap)
            for span, (begin, stop) in zip(chosen, self._ranges, strict=True)
        ]
        self._layers = [
            index
            for index, layer in enumerate(source.layers)
            if layer.born <= last and (layer.until is None or layer.until > self._begin)
        ]
        spans_of_layers = (source.layers[index] for index in self._layers)
        layers = tuple(
            LayerSpan(max(x.born - self._begin, 0), self._until(x.until, len(groups))) for x in spans_of_layers
        )
        sound, start = source.sound, first / source.header.fps
        sound = sound and replace(sound, files=None, pieces=part_of(sound.pieces, start))
        self.outline = replace(source.with_source(first), groups=tuple(groups), layers=layers, sound=sound)

    def layer_origin(self, index: int) -> tuple[Clip, int]:
        """Return the whole clip, and the index of a layer there."""
        return self._clip, self._layers[index]

    def group_origin(self, index: int) -> tuple[Clip, int]:
        """Return the whole clip, and the index of a group there."""
        return self._clip, self._begin + index

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return the frames of a group that the part has."""
        found = _renumbered(found, self._layers)
        span = self._clip.outline.groups[self._begin + index]
        begin, stop = (frame - span.first_frame for frame in self._ranges[index])
        return found if (begin, stop) == (0, span.frames) else _at_frames(found, np.arange(begin, stop))

    def _until(self, until: int | None, groups: int) -> int | None:
        return None if until is None or until - self._begin >= groups else until - self._begin


class Reversed(ChangedClip):
    """Clip backwards. Cross-fades stay where they were."""

    def __init__(self, clip: Clip) -> None:
        super().__init__(clip)
        source = self._source = clip.outline
        count, frames = len(source.groups), source.frames
        groups, before = [], -1
        for index in range(count - 1, -1, -1):
            first = max(frames - 1 - self._newest(index), before + 1)
            groups.append(ClipSpan(first, frames - source.groups[index].first_frame - first, self._overlap(index)))
            before = first
        layers = tuple(
            LayerSpan(0 if x.until is None else count - min(x.until, count), count - x.born if x.born else None)
            for x in source.layers
        )
        sound = source.sound
        if sound is not None:
            forward = padded(sound.pieces, source.seconds)
            sound = replace(sound, files=None, pieces=tuple(piece.reversed() for piece in reversed(forward)))
        self.outline = replace(source.with_source(None), groups=tuple(groups), layers=layers, sound=sound)

    def group_origin(self, index: int) -> tuple[Clip, int]:
        """Return the clip forwards, and the index of a group there."""
        return self._clip, len(self._source.groups) - 1 - index

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group backwards."""
        old, new = self._source.groups[-1 - index], self.outline.groups[index]
        frames = self._source.frames - 1 - np.arange(new.first_frame, new.end)
        return _at_frames(found, np.clip(frames - old.first_frame, 0, old.frames - 1))

    def _newest(self, index: int) -> int:
        """Return the last frame that shows a group: the end of the cross-fade to the next, where its weight is 0."""
        groups = self._source.groups
        if index + 1 == len(groups):
            return self._source.frames - 1
        following = groups[index + 1]
        return min(following.first_frame + (following.overlap or -1), self._source.frames - 1)

    def _overlap(self, index: int) -> int:
        """Return the overlap of a group with the one that is before it now. It is that of the later one, originally."""
        groups = self._source.groups
        return groups[index + 1].overlap if index + 1 < len(groups) else groups[index].overlap


class Retimed(ChangedClip):
    """Clip at another frame rate. Everything stays where it was at every second; motion between frames is interpolated."""

    def __init__(self, clip: Clip, fps: float) -> None:
        super().__init__(clip)
        source = self._source = clip.outline
        ratio = fps / source.header.fps
        self._ratio, frames = ratio, max(round(source.frames * ratio), 1)
        starts = [math.ceil(span.first_frame * ratio - 1e-9) for span in source.groups]
        self._chosen = [
            index
            for index, start in enumerate(starts)
            if start < frames and (index + 1 == len(starts) or start < min(starts[index + 1], frames))
        ]
        groups = []
        for place, index in enumerate(self._chosen):
            span, last = source.groups[index], place + 1 == len(self._chosen)
            end = (
                frames
                if last
                else min(max(math.ceil(span.end * ratio - 1e-9), starts[self._chosen[place + 1]]), frames)
            )
            overlap = max(round(span.overlap * ratio), 1) if span.overlap else 0
            groups.append(ClipSpan(starts[index], end - starts[index], overlap))
        header = replace(
            source.header,
            fps=fps,
            group_length=max(round(source.header.group_length * ratio), 1),
            overlap=max(round(source.header.overlap * ratio), 1) if source.header.overlap else 0,
        )
        number = np.searchsorted(self._chosen, np.arange(len(source.groups) + 1)).tolist()
        self._layers, layers = [], []
        for index, layer in enumerate(source.layers):
            born, until = number[layer.born], None if layer.until is None else number[min(layer.until, len(starts))]
            until = None if until is None or until >= len(groups) else until
            if born < len(groups) and (until is None or born < until):
                self._layers.append(index)
                layers.append(LayerSpan(born, until))
        retimed = replace(source, header=header, groups=tuple(groups), layers=tuple(layers))
        self.outline = retimed.with_source(0 if ratio == 1 else None)

    def layer_origin(self, index: int) -> tuple[Clip, int]:
        """Return the clip at its own frame rate, and the index of a layer there."""
        return self._clip, self._layers[index]

    def group_origin(self, index: int) -> tuple[Clip, int]:
        """Return the clip at its own frame rate, and the index of a group there."""
        return self._clip, self._chosen[index]

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group at the times of the new frames."""
        span = self.outline.groups[index]
        found = _renumbered(found, self._layers)
        old = self._source.groups[self._chosen[index]]
        times = np.arange(span.first_frame, span.end) / self._ratio - old.first_frame
        return _at_times(found, np.clip(times, 0, old.frames - 1))


def _renumbered(found: ClipGroup, layers: list[int]) -> ClipGroup:
    """Return a group of a clip that has only some layers of its source, by their indices there."""
    return replace(found, alive={number: found.alive[i] for number, i in enumerate(layers) if i in found.alive})


def _at_frames(found: ClipGroup, frames: np.ndarray) -> ClipGroup:
    """Return a group with some of its frames, in another order."""
    group = found.group
    shade = None if group.shade is None else group.shade[frames]
    return found.with_motion(
        group.dx[frames], group.dq[frames], shade, None if group.light is None else group.light[frames]
    )


def _at_times(found: ClipGroup, times: np.ndarray) -> ClipGroup:
    """Return a group at times [T] between its frames, interpolated as it is played (docs/format.md)."""
    group = found.group
    low = np.minimum(times.astype(int), max(group.frames - 2, 0))
    high = np.minimum(low + 1, group.frames - 1)
    share = (times - low).astype(np.float32)[:, None, None]

    def between(values: np.ndarray) -> np.ndarray:
        part = share if values.ndim == 3 else share[..., 0]
        return ((1 - part) * values[low] + part * values[high]).astype(np.float32)

    a, b = group.dq[low], group.dq[high]
    near = np.where((a * b).sum(-1, keepdims=True) < 0, -b, b)  # take the shorter rotation
    dq = rotations.normalize((1 - share) * a + share * near).astype(np.float32)
    shade = None if group.shade is None else between(group.shade)
    return found.with_motion(between(group.dx), dq, shade, None if group.light is None else between(group.light))
