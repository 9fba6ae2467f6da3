"""Thumbnails of a reel over time, for the seek bar: about 10 KB per minute, in sheets of several minutes."""

from __future__ import annotations

import math

import numpy as np

from splatreel.codec.presentation import Thumbnails
from splatreel.codec.writer import ReelWriter
from splatreel.play.jpeg import jpeg_within, to_bytes
from splatreel.play.timeline import Timeline

SIDE = 112
"""Pixels of the longer side of a thumbnail."""
SHORTEST, LONGEST = 0.25, 10.0
"""Minimum and maximum seconds between thumbnails."""
FEW = 8
"""Number of thumbnails of a short reel. A long one has one every `LONGEST` seconds."""
COLUMNS, ROWS = 6, 5
MOST_BYTES = 1300
"""Maximum mean size of a thumbnail."""
QUALITIES = (70, 60, 50, 40, 30, 20)


def write_thumbnails(writer: ReelWriter, reel: Timeline) -> Thumbnails:
    """Render thumbnails from the decoded reel and write their files. The manifest is left to `ReelWriter.present`.

    Thumbnails of times before the start of a reel show its first frame.
    """
    frames, fps, camera = reel.frames, reel.fps, reel.manifest.camera
    step = max(round(fps * min(max(frames / fps / FEW, SHORTEST), LONGEST)), 1)
    count = math.ceil(frames / step)
    scale = SIDE / max(camera.width, camera.height)
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
        sheets.append(writer.write_asset(uri, jpeg_within(pixels, MOST_BYTES * len(chosen), QUALITIES)))
    return Thumbnails(camera.width, camera.height, columns, rows, step / fps, count, tuple(sheets))
