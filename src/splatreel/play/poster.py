"""The poster that is shown until a reel plays: the first frame, seen by the start camera."""

from __future__ import annotations

from splatreel.codec.presentation import Poster
from splatreel.codec.writer import ReelWriter
from splatreel.play.jpeg import jpeg_within, to_bytes
from splatreel.play.timeline import Timeline

URI = "poster.jpg"
SIDES = (960, 640)
"""Pixels of the longer side. The second is used if the first exceeds `MOST_BYTES` at every quality."""
MOST_BYTES = 24_000
"""Maximum size, chosen to arrive within the first round trip of a slow connection."""


def write_poster(writer: ReelWriter, reel: Timeline) -> Poster:
    """Render the poster from the decoded reel and write its file. The manifest is left to `ReelWriter.present`."""
    camera, data = reel.manifest.camera, b""
    for side in SIDES:
        scale = side / max(camera.width, camera.height)
        camera = camera.resized(max(round(camera.width * scale), 1), max(round(camera.height * scale), 1))
        data = jpeg_within(to_bytes(reel.render(reel.at(0), camera)), MOST_BYTES)
        if len(data) <= MOST_BYTES:
            break
    return Poster(writer.write_asset(URI, data), camera.width, camera.height)
