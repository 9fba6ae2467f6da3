"""Sound of a clip as a list of pieces, which operations cut, reverse and join."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatreel.codec.fragments import RATE

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


def read_pieces(pieces: Sequence[SoundPiece], channels: int, start: float, seconds: float) -> np.ndarray:
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
