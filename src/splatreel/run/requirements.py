"""Requirements that a capture must meet to be reconstructed, for `capture check` and for reconstruction."""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import ReconstructionError
from splatreel.capture.base import Capture
from splatreel.config import LayeringConfig
from splatreel.method.images.flow import RAFT
from splatreel.method.layering.sam2 import SAM2

MIN_CAMERAS = 3
"""Smallest number of training cameras."""
MIN_SIDE = 8
"""Smallest side of an image in pixels. Smaller images show no features that cameras could agree on."""
BLACK, WHITE = 24, 231
"""Gray levels: an image is black if no pixel is above the first, and white if none is below the second. Both allow for noise."""


def check_capture(capture: Capture) -> None:
    """Check the number of cameras and the size of the images.

    Raises:
        ReconstructionError: The capture can be read, but not reconstructed.
    """
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


def check_networks(config: LayeringConfig) -> None:
    """Check that the networks of layering are on this machine. They are loaded after the first keyframe only.

    Raises:
        MissingDependencyError: A package or its weights are missing.
    """
    if config.flow == "raft":
        RAFT.check()
    if config.segment == "sam2":
        SAM2.check()


def check_images(capture: Capture, names: list[str], frames: np.ndarray) -> None:
    """Check that every camera shows something.

    Args:
        capture: The capture, for the error.
        names: Names of the cameras.
        frames: Their images [T, C, H, W, 3] uint8 of some moments.

    Raises:
        ReconstructionError: All images of a camera are black or white.
    """
    black, white = (frames <= BLACK).all((0, 2, 3, 4)), (frames >= WHITE).all((0, 2, 3, 4))
    for color, blank in (("black", black), ("white", white)):
        if blank.any():
            which = [name for name, flat in zip(names, np.atleast_1d(blank), strict=True) if flat]
            some = "every camera" if len(which) == len(names) else f"camera {', '.join(which)}"
            raise ReconstructionError(
                f"{capture.path}: all images of {some} are {color}. Choose other frames (--frames A:B), or remove the camera: its "
                "video and its pose."
            )
