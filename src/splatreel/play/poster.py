"""The poster, which is shown until a reel plays: the start camera's picture at the first frame, as a player will show it."""

from __future__ import annotations

from splatreel.codec.presentation import Poster
from splatreel.codec.writer import ReelWriter
from splatreel.play.jpeg import jpeg_within, to_bytes
from splatreel.play.timeline import Timeline

URI = "poster.jpg"
SIDES = (960, 640)
"""Pixels of the longer side; the second where a picture takes too much in the first, however coarse."""
MOST_BYTES = 24_000
"""It comes within the first round trip of a slow line."""


def write_poster(writer: ReelWriter, reel: Timeline) -> Poster:
    """Draw it from the reel as decoded; the same bytes for the same reel. Only the file is written, see `ReelWriter.present`."""
    camera, data = reel.manifest.camera, b""
    for side in SIDES:
        scale = side / max(camera.width, camera.height)
        camera = camera.resized(max(round(camera.width * scale), 1), max(round(camera.height * scale), 1))
        data = jpeg_within(to_bytes(reel.render(reel.at(0), camera)), MOST_BYTES)
        if len(data) <= MOST_BYTES:
            break
    return Poster(writer.write_asset(URI, data), camera.width, camera.height)
