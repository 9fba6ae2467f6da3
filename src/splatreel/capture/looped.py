"""A capture played over and over, to see what a long video does."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.capture.base import Capture


class LoopedCapture(Capture):
    """As many frames as one likes of a capture: after the last comes the first again. The source stays the caller's to close."""

    def __init__(self, source: Capture, frames: int) -> None:
        self.source = source
        super().__init__(
            source.path,
            source.cameras,
            held_out=source.held_out,
            frame_range=(0, frames),
            fps=source.fps,
            points=source.points,
            point_colors=source.point_colors,
            near=source.near,
        )

    def sources(self) -> list[Path]:
        return self.source.sources()

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        done = 0
        while done < len(out):
            frame = (first + done) % self.source.frames
            count = min(self.source.frames - frame, len(out) - done)
            out[done : done + count] = self.source.read(frame, count, cameras)
            done += count
