"""Sound of an edited reel: from a file, copied, or encoded again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatreel.base.errors import UsageError
from splatreel.capture.capture_sound import channels, read_sound
from splatreel.codec.fragments import RATE
from splatreel.codec.opus_sound import encode_sound, write_sound
from splatreel.codec.writer import ReelWriter
from splatreel.edit.clip import ClipSound, Outline
from splatreel.edit.sound_pieces import SoundPiece

BLOCK = 2.0
"""Seconds that are read at a time."""


class FileSound:
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
    sound = FileSound(file, start)
    return replace(outline, sound=ClipSound(sound.channels, None, (SoundPiece(sound.read),)))


def write_clip_sound(writer: ReelWriter, outline: Outline) -> None:
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
