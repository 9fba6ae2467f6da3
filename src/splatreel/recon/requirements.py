"""What a capture must be like to be reconstructed."""

from __future__ import annotations

from splatreel.capture.base import Capture
from splatreel.errors import ReconstructionError

MIN_CAMERAS = 3
MIN_SIDE = 8
"""Pixels; smaller images show nothing that cameras could agree on."""


def check_capture(capture: Capture) -> None:
    """Raises `ReconstructionError` for a capture that can be read, but not reconstructed."""
    count = len(capture.training_cameras)
    if count < MIN_CAMERAS:
        raise ReconstructionError(
            f"{capture.path}: only {count} cameras are left to train on besides the held-out {', '.join(capture.held_out)}; "
            f"at least {MIN_CAMERAS} are needed. Hold out fewer, or add cameras."
        )
    if min(capture.width, capture.height) < MIN_SIDE:
        raise ReconstructionError(
            f"{capture.path}: images of {capture.width}x{capture.height} pixels are too small, each side needs at least "
            f"{MIN_SIDE}. Ask for a larger width or scale."
        )
