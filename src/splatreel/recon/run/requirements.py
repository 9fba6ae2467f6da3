"""What a capture must bring to be reconstructed: one list, of `capture check` and of reconstruction itself."""

from __future__ import annotations

import numpy as np

from splatreel.capture.base import Capture
from splatreel.errors import ReconstructionError

MIN_CAMERAS = 3
MIN_SIDE = 8
"""Pixels; smaller images show nothing that cameras could agree on."""
BLACK, WHITE = 24, 231
"""Gray levels up to which, and from which on, a picture is called black or white: what videos call so, and some noise."""


def check_capture(capture: Capture) -> None:
    """Raises `ReconstructionError` for a capture that can be read, but not reconstructed."""
    count = len(capture.training_cameras)
    if count < MIN_CAMERAS:
        raise ReconstructionError(
            f"{capture.path}: only {count} cameras are left to train on besides the held-out {', '.join(capture.held_out)}; "
            f"at least {MIN_CAMERAS} are needed. Hold out fewer (--hold-out none: all are trained on), or add cameras."
        )
    if min(capture.width, capture.height) < MIN_SIDE:
        raise ReconstructionError(
            f"{capture.path}: images of {capture.width}x{capture.height} pixels are too small, each side needs at least "
            f"{MIN_SIDE}. Ask for a larger width or scale."
        )


def check_pictures(capture: Capture, names: list[str], frames: np.ndarray) -> None:
    """Raises `ReconstructionError` for cameras that show nothing. frames: [T, C, H, W, 3] uint8, some moments of the named ones."""
    for color, blank in (
        ("black", (frames <= BLACK).all((0, 2, 3, 4))),
        ("white", (frames >= WHITE).all((0, 2, 3, 4))),
    ):
        if blank.any():
            which = [name for name, flat in zip(names, np.atleast_1d(blank), strict=True) if flat]
            some = "every camera" if len(which) == len(names) else f"camera {', '.join(which)}"
            raise ReconstructionError(
                f"{capture.path}: what {some} shows is all {color}. Choose frames in which there is a picture (--frames A:B), or leave "
                f"the camera out: its video, and its pose."
            )
