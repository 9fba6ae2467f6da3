"""A reel as a clip."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from splatreel.base.errors import ReelError, UsageError
from splatreel.codec.group_file import decode_group_to_edit, decode_layer_to_edit
from splatreel.codec.header import ReelHeader
from splatreel.codec.manifest import FileEntry, Manifest
from splatreel.codec.presentation import MAX_TEXT
from splatreel.codec.reader import ReelReader
from splatreel.config import COARSENESS
from splatreel.edit.clip import ClipGroup, ClipLayer, ClipSound, ClipSpan, LayerSpan, Outline, SoundPiece
from splatreel.play.reel_sound import ReelSound

CACHED = 4
"""Decoded layers, and groups, that are kept: several operations of an edit ask for the same ones."""
T = TypeVar("T")


class ReelClip:
    """Layers and groups of a finished reel, counted from its first frame.

    Args:
        location: Folder or address of the reel.

    Raises:
        ReelError: The location is not a reel.
        UsageError: The reel is still being written, or has unknown renditions.
    """

    def __init__(self, location: str | Path) -> None:
        self._reader = ReelReader(location)
        manifest = self._manifest = self._reader.manifest
        if manifest.live:
            raise UsageError(f"{self._reader.name}: is still being written. Edit the reel when it is finished.")
        if not set(manifest.renditions) <= set(COARSENESS):
            raise UsageError(
                f"{self._reader.name}: has the renditions {', '.join(manifest.renditions)}, and only "
                f"{', '.join(COARSENESS)} can be written. Edit the reel that it was made from."
            )
        first = manifest.first_group
        self.outline = Outline(
            name=str(location),
            header=replace(
                ReelHeader(**{name: getattr(manifest, name) for name in ReelHeader.__dataclass_fields__}),
                source=manifest.source and replace(manifest.source.shifted(manifest.first_frame), edited=True),
            ),
            limits=manifest.presentation.limits,
            texts={name: getattr(manifest.presentation, name) for name in MAX_TEXT},
            renditions=manifest.renditions,
            layers=tuple(
                LayerSpan(max(layer.group - first, 0), None if layer.until is None else layer.until - first)
                for layer in manifest.layers
            ),
            groups=tuple(self._span(entry) for entry in manifest.groups),
            sound=_sound(self._reader, manifest),
        )
        self._layers: OrderedDict[int, ClipLayer] = OrderedDict()
        self._groups: OrderedDict[tuple[int, str | None], ClipGroup] = OrderedDict()

    @property
    def bytes(self) -> int:
        """Size of all layers and groups."""
        return sum(file.bytes for file in self._manifest.files)

    def layer(self, index: int) -> ClipLayer:
        """Return a layer, decoded."""
        return _cached(self._layers, index, lambda: self._decode_layer(self._manifest.layers[index]))

    def group(self, index: int, rendition: str | None = None) -> ClipGroup:
        """Return a group, decoded; by default the best rendition."""
        return _cached(self._groups, (index, rendition), lambda: self._decode_group(index, rendition))

    def _span(self, entry: FileEntry) -> ClipSpan:
        overlap = self._manifest.overlap if entry.overlap is None else entry.overlap
        return ClipSpan(entry.first_frame - self._manifest.first_frame, entry.frames, overlap)

    def _decode_layer(self, entry: FileEntry) -> ClipLayer:
        points, precision = decode_layer_to_edit(self._reader.read_file(entry), entry.uri)
        self._check(entry, len(points), entry.points, "points")
        return ClipLayer(points, precision)

    def _decode_group(self, index: int, rendition: str | None) -> ClipGroup:
        entry = self._manifest.groups[index]
        entry = entry.renditions.get(rendition, entry) if rendition else entry
        group, precision = decode_group_to_edit(self._reader.read_file(entry), entry.uri)
        living = self.outline.living(index)
        sizes = [self._manifest.layers[layer].points for layer in living]
        self._check(entry, len(group.dynamic), entry.points, "points")
        self._check(entry, group.frames, entry.frames, "frames")
        self._check(entry, len(group.alive), sum(sizes), "alive flags")
        flags = np.split(group.alive, np.cumsum(sizes)[:-1]) if sizes else []
        return ClipGroup(group, dict(zip(living, flags, strict=True)), precision)

    def _check(self, entry: FileEntry, found: int, said: int, what: str) -> None:
        if found != said:
            raise ReelError(f"{entry.uri}: has {found} {what}, the manifest says {said}. Copy the reel again.")


def _sound(reader: ReelReader, manifest: Manifest) -> ClipSound | None:
    sound = manifest.presentation.sound
    if sound is None:
        return None
    samples, begin = ReelSound(reader, sound), manifest.first_frame / manifest.fps
    if sound.channels > 2:
        raise UsageError(f"{reader.name}: has sound of {sound.channels} channels; only 1 or 2 can be written.")
    files = None if begin else (reader, sound)
    return ClipSound(sound.channels, sound.position, (SoundPiece(samples.samples, start=begin),), files)


def _cached(cache: OrderedDict, key: object, load: Callable[[], T]) -> T:
    if key not in cache:
        cache[key] = load()
        if len(cache) > CACHED:
            cache.popitem(last=False)
    cache.move_to_end(key)
    return cache[key]
