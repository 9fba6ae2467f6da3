"""`splatreel capture check`."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from splatreel.cli.options import parse_frames

CHUNK = 8
"""Frames of all cameras held in memory at a time."""


def capture_check(capture: Positional[Path], /, width: int | None = None, frames: str | None = None) -> None:
    """Read a capture through and say what it holds, before hours are spent on it.

    Args:
        capture: Folder of the videos or images and their cameras.
        width: Width to read it at, in pixels; its own by default.
        frames: Which frames, as A:B; all by default.
    """
    from splatreel.capture.opening import open_capture
    from splatreel.progress import console

    source = open_capture(capture, width=width, frames=parse_frames(frames))
    progress = console()
    try:
        progress.stage("reading", source.frames)
        names = [camera.name for camera in source.cameras]
        for first in range(0, source.frames, CHUNK):
            count = min(CHUNK, source.frames - first)
            source.read(first, count, names)
            progress.update(first + count)
    finally:
        progress.close()
        source.close()
    held_out = ", ".join(source.held_out) or "none"
    points = "no points" if source.points is None else f"{len(source.points):,} points"
    print(f"{capture}: {type(source).__name__}, every frame can be read")
    print(f"  {len(names)} cameras, held out: {held_out}; {points}")
    print(f"  {source.frames} frames at {source.fps:g} a second, {source.width} x {source.height} pixels")
