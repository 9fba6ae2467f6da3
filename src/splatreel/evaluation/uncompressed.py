"""A run before it was encoded: the reference for what compression costs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

from splatreel.codec.reader import ReelReader
from splatreel.play.timeline import Timeline
from splatreel.recon.encode.uncompressed import UncompressedReel
from splatreel.scene.gaussians import Gaussians


def uncompressed_frames(work: Path, reel: Path) -> Callable[[int], Gaussians]:
    """A function from a frame to everything visible at it, from the checkpoints in `work` and not from the reel's files.

    Raises `ReconstructionError` for checkpoints that are missing or damaged.
    """
    timeline = Timeline(cast(ReelReader, UncompressedReel(work, reel)))
    return lambda frame: timeline.at(frame / timeline.fps)
