"""Clips one after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatreel.base.errors import UsageError
from splatreel.codec.presentation import Limits
from splatreel.edit.clip import ChangedClip, Clip, ClipGroup, ClipSound, LayerSpan, Outline, padded


class Joined(ChangedClip):
    """Two clips, the second after the first, with a hard cut between them. Texts are those of the first.

    Raises:
        UsageError: The clips do not fit together.
    """

    def __init__(self, first: Clip, second: Clip) -> None:
        a, b = first.outline, second.outline
        _check(a, b)
        super().__init__(first)
        self._second = second
        self._groups = len(a.groups)
        self._layers = len(a.layers)
        frames, groups = a.frames, len(a.groups)
        ending = [LayerSpan(x.born, groups if x.until is None else min(x.until, groups)) for x in a.layers]
        later = [LayerSpan(x.born + groups, None if x.until is None else x.until + groups) for x in b.layers]
        overlaps = [0, *(span.overlap for span in b.groups[1:])]
        appended = [
            replace(span, first_frame=span.first_frame + frames, overlap=overlap)
            for span, overlap in zip(b.groups, overlaps, strict=True)
        ]
        known = {camera.viewmat.tobytes() for camera in a.header.cameras}
        others = [camera for camera in b.header.cameras if camera.viewmat.tobytes() not in known]
        header = replace(
            a.header,
            cameras=(*a.header.cameras, *others),
            sh_degree=max(a.header.sh_degree, b.header.sh_degree),
            bounds=np.stack(
                [
                    np.minimum(a.header.bounds[0], b.header.bounds[0]),
                    np.maximum(a.header.bounds[1], b.header.bounds[1]),
                ]
            ),
            near=min(a.header.near, b.header.near),
        )
        same = a.header.source is not None and a.with_source(None).header.source == b.with_source(None).header.source
        self.outline = replace(
            a,
            header=replace(header, source=a.with_source(None).header.source if same else None),
            limits=_widest(a.limits, b.limits),
            renditions=a.renditions if a.renditions == b.renditions else (),
            layers=(*ending, *later),
            groups=(*a.groups, *appended),
            sound=_sound(a, b),
        )

    def layer_origin(self, index: int) -> tuple[Clip, int]:
        """Return either clip, and the index of a layer there."""
        return (self._clip, index) if index < self._layers else (self._second, index - self._layers)

    def group_origin(self, index: int) -> tuple[Clip, int]:
        """Return either clip, and the index of a group there."""
        return (self._clip, index) if index < self._groups else (self._second, index - self._groups)

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group with the numbers that its layers have in the joined clip."""
        if index < self._groups:
            return found
        return replace(found, alive={layer + self._layers: flags for layer, flags in found.alive.items()})


def _check(a: Outline, b: Outline) -> None:
    """Refuse clips whose images would change where they meet."""
    one, other = a.header, b.header
    if abs(one.fps - other.fps) > 1e-9 * one.fps:
        raise UsageError(
            f"join: {b.name} has {other.fps:g} frames per second, {a.name} {one.fps:g}. Write fps={other.fps:g} before join, or edit "
            "the other reel first."
        )
    same = {
        "antialias": one.antialias == other.antialias,
        "background": one.background == other.background and one.transparent == other.transparent,
        "up direction": np.allclose(one.up, other.up, atol=1e-3),
        "origin": np.allclose(one.origin, other.origin, atol=1e-6),
        "clearance": np.isclose(one.clearance.share, other.clearance.share, atol=1e-6),
    }
    wrong = [name for name, fits in same.items() if not fits]
    if wrong:
        raise UsageError(
            f"join: {b.name} and {a.name} differ in their {', '.join(wrong)}. Join reels of one scene, or edit one of them first."
        )


def _widest(a: Limits | None, b: Limits | None) -> Limits | None:
    """Return limits that allow every view of either clip."""
    if a is None or b is None or a == b:
        return a if a == b else None
    floors, angles = (a.floor, b.floor), (a.angle, b.angle)
    distances = None
    if a.distance is not None and b.distance is not None:
        distances = min(a.distance[0], b.distance[0]), max(a.distance[1], b.distance[1])
    return Limits(
        a.focus,
        angle=None if None in angles else max(angle for angle in angles if angle is not None),
        distance=distances,
        floor=None if None in floors else min(floor for floor in floors if floor is not None),
    )


def _sound(a: Outline, b: Outline) -> ClipSound | None:
    if a.sound is None and b.sound is None:
        return None
    channels = max(sound.channels for sound in (a.sound, b.sound) if sound is not None)
    positions = {sound.position for sound in (a.sound, b.sound) if sound is not None}
    before, after = (() if sound is None else sound.pieces for sound in (a.sound, b.sound))
    return ClipSound(channels, positions.pop() if len(positions) == 1 else None, (*padded(before, a.seconds), *after))
