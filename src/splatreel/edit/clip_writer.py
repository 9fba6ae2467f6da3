"""Writer of a clip as a reel. Points that no operation touched are encoded as they were."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatreel.base.errors import ReelError, UsageError
from splatreel.base.new_folder import is_taken, new_folder
from splatreel.capture.capture_sound import channels, read_sound
from splatreel.codec.group_file import encode_group_again, encode_layer_again
from splatreel.codec.mp4 import RATE
from splatreel.codec.opus_sound import encode_sound, write_sound
from splatreel.codec.predictive.precision import STEPS, Precision, choose_precision
from splatreel.codec.presentation import EMPTY
from splatreel.codec.reader import ReelReader
from splatreel.codec.writer import ReelWriter
from splatreel.config import COARSENESS, EncodeConfig, Rate
from splatreel.edit.clip import Clip, ClipGroup, ClipSound, LayerSpan, Outline, SoundPiece
from splatreel.play.presentation_writer import PresentationWriter
from splatreel.scene.gaussians import Gaussians

BLOCK = 2.0
"""Seconds that are read at a time."""


class _FileSound:
    """Samples of a sound file from `start` seconds on; a negative start is silence first."""

    def __init__(self, file: Path, start: float) -> None:
        self.file = file
        self.start = start
        self.channels = channels(file)
        if not self.channels:
            raise UsageError(f"sound={file}: has no sound. Name another file, or none.")
        self._blocks: Iterator[np.ndarray] = iter(())
        self._next = -1
        self._rest = np.zeros((0, self.channels), np.float32)

    def read(self, start: float, seconds: float) -> np.ndarray:
        """Return samples [n, channels] of a range. Ranges that follow each other are read once from the file."""
        first, count = round((self.start + start) * RATE), max(round(seconds * RATE), 0)
        silence = min(max(-first, 0), count)
        first, count = first + silence, count - silence
        if first != self._next:
            self._blocks = read_sound(self.file, self.channels, RATE, first / RATE)
            self._rest = self._rest[:0]
        while len(self._rest) < count and (block := next(self._blocks, None)) is not None:
            self._rest = np.concatenate([self._rest, block])
        found, self._rest, self._next = self._rest[:count], self._rest[count:], first + count
        ends = np.zeros((silence, self.channels)), np.zeros((count - len(found), self.channels))
        return np.concatenate([ends[0], found, ends[1]]).astype(np.float32)


def replace_sound(outline: Outline, file: Path | None, start: float = 0.0) -> Outline:
    """Return the facts of a clip with the sound of a file, or with none.

    Args:
        outline: Facts of the clip.
        file: Sound or video file; None removes the sound.
        start: Seconds of the file that are skipped; negative for silence before it.

    Raises:
        CaptureError: The file cannot be read.
        UsageError: The file has no sound.
    """
    if file is None:
        return replace(outline, sound=None)
    sound = _FileSound(file, start)
    return replace(outline, sound=ClipSound(sound.channels, None, (SoundPiece(sound.read),)))


def _write_clip_sound(writer: ReelWriter, outline: Outline) -> None:
    """Write the sound of a clip into a reel that has all its groups. The files of an unchanged sound are copied."""
    sound = outline.sound
    if sound is None:
        return
    if sound.files is None:
        write_sound(writer, encode_sound(_blocks(sound, outline.seconds), sound.channels), sound.position)
        return
    reader, described = sound.files
    for asset in described.assets:
        writer.write_asset(asset.uri, reader.read_file(asset))
    described = replace(described, position=sound.position)
    writer.present(replace(writer.manifest.presentation, sound=described))


def _blocks(sound: ClipSound, seconds: float) -> Iterator[np.ndarray]:
    """Yield all samples in blocks, without a gap between their rounded times."""
    count, size = round(seconds * RATE), round(BLOCK * RATE)
    for first in range(0, count, size):
        yield sound.read(first / RATE, min(size, count - first) / RATE)


def write_clip(clip: Clip, out: Path, progress: Callable[[int], None] = lambda done: None) -> int:
    """Write a clip into a new folder, which appears when it is complete. The same reel may be there already.

    Args:
        clip: The clip.
        out: Folder of the new reel.
        progress: Receives the number of groups written.

    Returns:
        Bytes of the new reel's layers and groups.

    Raises:
        UsageError: `out` exists and is not the same reel, or no point is left.
        ReelError: A file of the reel is damaged.
        StorageError: The disk is full or cannot be written.
    """
    refusal = UsageError(f"--out {out}: exists already. Choose another folder, or delete it.")
    if is_taken(out) and not _is_alike(out, clip):
        raise refusal
    try:
        with new_folder(out, refusal) as made:

            def update(done: int) -> None:
                made.check("layers", "groups")
                progress(done)

            return _ClipWriter(clip, made.path).write(update)
    except OSError as error:
        raise ReelError(
            f"{out}: cannot be written ({error.strerror or error}). Fix the permissions or name another folder."
        ) from error


def _is_alike(folder: Path, clip: Clip) -> bool:
    """Return whether a folder holds a finished reel with the frames, groups and texts of a clip."""
    try:
        there = ReelReader(folder).manifest
    except ReelError:
        return False
    outline = clip.outline
    texts = all(getattr(there.presentation, name) == text for name, text in outline.texts.items())
    same = (there.frames, there.fps, len(there.groups)) == (outline.frames, outline.header.fps, len(outline.groups))
    return same and texts and not there.live


class _ClipWriter:
    def __init__(self, clip: Clip, place: Path) -> None:
        outline = clip.outline
        self.clip = clip
        self.outline = outline
        rates: tuple[Rate, ...] = tuple(rate for rate in COARSENESS if rate in outline.renditions)
        self.writer = ReelWriter(place, outline.header, config=EncodeConfig(renditions=rates))
        self.renditions: list[str | None] = list(rates) if len(rates) > 1 else [None]
        self.orders: dict[int, np.ndarray] = {}
        self.points = 0

    def write(self, progress: Callable[[int], None]) -> int:
        for index in range(len(self.outline.groups)):
            for layer in sorted(self._born(index), key=lambda number: _longest_first(self.outline.layers[number])):
                self._write_layer(layer, index)
            self._write_group(index)
            progress(index + 1)
        if not self.points:
            raise UsageError(
                f"{self.outline.name}: no point is left after these operations. Choose a larger volume or less."
            )
        self.writer.present(replace(EMPTY, **self.outline.texts, limits=self.outline.limits))
        _write_clip_sound(self.writer, self.outline)
        PresentationWriter()(self.writer, None)
        self.writer.finish()
        return sum(file.bytes for file in self.writer.manifest.files)

    def _born(self, group: int) -> list[int]:
        return [index for index, layer in enumerate(self.outline.layers) if layer.born == group]

    def _write_layer(self, index: int, group: int) -> None:
        layer, span = self.clip.layer(index), self.outline.groups[group]
        until = self.outline.layers[index].until
        self.orders[index] = np.zeros(0, np.int64)
        if not len(layer.points):
            return
        precision = layer.precision or _fine(layer.points, moving=False)
        data, order = encode_layer_again(group, span.first_frame, layer.points, precision)
        self.writer.add_layer(group, span.first_frame, layer.points, encoded=((data,), order), until=until)
        self.orders[index] = order
        self.points += len(order)

    def _write_group(self, index: int) -> None:
        span, files = self.outline.groups[index], {}
        overlap = None if span.overlap == self.outline.header.overlap else span.overlap
        group = None
        for rendition in self.renditions:
            best = rendition == self.renditions[0]
            found = self.clip.group(index, rendition)
            numbered = replace(found.group, index=index, first_frame=span.first_frame, alive=self._alive(index, found))
            group = numbered if best else group
            precision = found.precision
            if precision is None and len(numbered.dynamic):
                precision = _fine(numbered.dynamic, moving=True)
            name = f"groups/{index:04d}" if best else f"groups/{index:04d}.{rendition}"
            files[f"{name}.safetensors"] = encode_group_again(numbered, precision)[0]
        assert group is not None
        self.points += len(group.dynamic)
        self.writer.add_group(group, encoded=files, overlap=overlap if index else None)
        self._forget_retired(index)

    def _alive(self, index: int, found: ClipGroup) -> np.ndarray:
        """Return the alive flags of all living layers, in the order of the reel."""
        living = sorted(self.outline.living(index), key=lambda number: _birth_order(self.outline.layers[number]))
        flags = [found.alive[number][self.orders[number]] for number in living]
        return np.concatenate([np.zeros(0, bool), *flags])

    def _forget_retired(self, index: int) -> None:
        for number, layer in enumerate(self.outline.layers):
            if layer.until is not None and layer.until <= index + 1:
                self.orders.pop(number, None)


def _fine(points: Gaussians, moving: bool) -> Precision:
    """Return the precision of points that were in the paper's coding, which the predictive one replaces."""
    return choose_precision(points.scales, None, COARSENESS["high"], moving, STEPS)


def _longest_first(layer: LayerSpan) -> float:
    return -float("inf") if layer.until is None else -layer.until


def _birth_order(layer: LayerSpan) -> tuple[int, float]:
    return layer.born, _longest_first(layer)
