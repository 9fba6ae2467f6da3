"""Writes the presentation of a reel while the reel is written: texts, a poster, thumbnails.

The poster is shown until the reel plays: the first frame, seen by the start camera. Thumbnails over time are for the seek bar: about
10 KB per minute, in sheets of several minutes.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from PIL import Image

from splatreel.codec.presentation import Poster, Thumbnails, check_text
from splatreel.codec.writer import ReelWriter
from splatreel.play.timeline import Timeline, open_reel

_POSTER_URI = "poster.jpg"
_POSTER_SIDES = (960, 640)
"""Pixels of the longer side of the poster. The second is used if the first exceeds `POSTER_BYTES` at every quality."""
POSTER_BYTES = 24_000
"""Maximum size of the poster, chosen to arrive within the first round trip of a slow connection."""
_THUMBNAIL_SIDE = 112
"""Pixels of the longer side of a thumbnail."""
SHORTEST, LONGEST = 0.25, 10.0
"""Minimum and maximum seconds between thumbnails."""
FEW = 8
"""Number of thumbnails of a short reel. A long one has one every `LONGEST` seconds."""
COLUMNS, ROWS = 6, 5
"""Maximum number of columns and rows of a sheet of thumbnails."""
_THUMBNAIL_BYTES = 1300
"""Maximum mean size of a thumbnail."""
_THUMBNAIL_QUALITIES = (70, 60, 50, 40, 30, 20)
QUALITIES = (80, 70, 60, 50, 40, 30)


@dataclass(frozen=True)
class PresentationWriter:
    """Callback of a reel writer that keeps the presentation up to date.

    Call it with the writer and the number of the group that was just written, or None just before the reel is complete. It raises
    `ReelError` if a text is too long or a file cannot be written.
    """

    words: Mapping[str, str] = field(default_factory=dict)
    """Texts to set: any of `title`, `author`, `description` and `licence`. The others do not change."""
    otherwise: Mapping[str, str] = field(default_factory=dict)
    """Texts to set if the reel has none of that name."""

    def __call__(self, writer: ReelWriter, group: int | None) -> None:
        """Write what changed of the presentation."""
        before = writer.manifest.presentation
        missing = {name: text for name, text in self.otherwise.items() if not getattr(before, name)}
        words = {name: check_text(name, text) for name, text in (missing | dict(self.words)).items()}
        after = replace(before, **words)
        if group == 0 or after.poster is None:
            after = replace(after, poster=_write_poster(writer, open_reel(writer.path)))
        if group is not None:
            after = replace(after, thumbnails=None)  # they belong to an earlier, complete reel
        elif after.thumbnails is None:
            after = replace(after, thumbnails=_write_thumbnails(writer, open_reel(writer.path)))
        if after != before:
            writer.present(after)


def _write_poster(writer: ReelWriter, reel: Timeline) -> Poster:
    """Render the poster from the decoded reel and write its file. The manifest is left to `ReelWriter.present`."""
    camera, data = reel.manifest.camera, b""
    for side in _POSTER_SIDES:
        scale = side / max(camera.width, camera.height)
        camera = camera.resized(max(round(camera.width * scale), 1), max(round(camera.height * scale), 1))
        data = jpeg_within(to_bytes(reel.render(reel.at(0), camera)), POSTER_BYTES)
        if len(data) <= POSTER_BYTES:
            break
    return Poster(writer.write_asset(_POSTER_URI, data), camera.width, camera.height)


def _write_thumbnails(writer: ReelWriter, reel: Timeline) -> Thumbnails:
    """Render thumbnails from the decoded reel and write their files. The manifest is left to `ReelWriter.present`.

    Thumbnails of times before the start of a reel show its first frame.
    """
    frames, fps, camera = reel.frames, reel.fps, reel.manifest.camera
    step = max(round(fps * min(max(frames / fps / FEW, SHORTEST), LONGEST)), 1)
    count = math.ceil(frames / step)
    scale = _THUMBNAIL_SIDE / max(camera.width, camera.height)
    camera = camera.resized(max(round(camera.width * scale), 1), max(round(camera.height * scale), 1))
    columns, rows = min(count, COLUMNS), min(math.ceil(count / COLUMNS), ROWS)
    sheets, drawn = [], {}
    for first in range(0, count, columns * rows):
        sheet = np.zeros((rows, columns, camera.height, camera.width, 3), np.uint8)
        chosen = range(first, min(first + columns * rows, count))
        for index in chosen:
            row, column = divmod(index - first, columns)
            frame = max(index * step, reel.manifest.first_frame)
            if frame not in drawn:
                drawn = {frame: to_bytes(reel.render(reel.at(frame / fps), camera))}
            sheet[row, column] = drawn[frame]
        pixels = sheet.swapaxes(1, 2).reshape(rows * camera.height, columns * camera.width, 3)
        uri = f"thumbnails/{len(sheets):04d}.jpg"
        sheets.append(
            writer.write_asset(uri, jpeg_within(pixels, _THUMBNAIL_BYTES * len(chosen), _THUMBNAIL_QUALITIES))
        )
    return Thumbnails(camera.width, camera.height, columns, rows, step / fps, count, tuple(sheets))


def jpeg_within(pixels: np.ndarray, most: int, qualities: Sequence[int] = QUALITIES) -> bytes:
    """Encode pixels as a progressive JPEG of bounded size.

    Args:
        pixels: [H, W, 3] uint8.
        most: Maximum number of bytes. If no quality fits, the last one is used.
        qualities: Qualities to try, best first.
    """
    data = b""
    for quality in qualities:
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "JPEG", quality=quality, progressive=True, optimize=True)
        data = file.getvalue()
        if len(data) <= most:
            break
    return data


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Convert colors from float to uint8, clipped to 0..1."""
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
