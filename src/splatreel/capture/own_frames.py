"""Frames that the files of a camera hold, for files that belong to them, such as masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np


@dataclass(frozen=True)
class OwnFrames:
    """Frames that a camera's files hold.

    Attributes:
        numbers: Number of the frame that each time step shows, [T] int. Frames are counted from 0.
        count: Number of frames.
        stems: Names of the images without their suffixes; None for a video.
    """

    numbers: np.ndarray
    count: int
    stems: Sequence[str] | None = None


@runtime_checkable
class CountedSource(Protocol):
    """Source of images that knows the frames of its cameras."""

    def own_frames(self, name: str) -> OwnFrames:
        """Return the frames of a camera's files."""
        ...
