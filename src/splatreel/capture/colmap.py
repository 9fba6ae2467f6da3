"""COLMAP models: one time step of undistorted photographs with their cameras and sparse points."""

from __future__ import annotations

from pathlib import Path

from splatreel.capture.base import Capture, Request


def is_colmap(path: Path) -> bool:
    return False


class ColmapCapture(Capture):
    def __init__(self, path: Path, request: Request) -> None: ...
