"""Gaussians of a run before encoding, the reference for coding loss."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

from splatreel.codec.reader import ReelReader
from splatreel.play.timeline import Timeline
from splatreel.recon.encode.uncompressed import UncompressedReel
from splatreel.scene.gaussians import Gaussians


def uncompressed_frames(work: Path, reel: Path) -> Callable[[int], Gaussians]:
    """Return a function from a frame to all Gaussians visible at it, from the checkpoints in `work` instead of the reel's files.

    Raises:
        ReconstructionError: A checkpoint is missing or damaged.
    """
    timeline = Timeline(cast(ReelReader, UncompressedReel(work, reel)))
    return lambda frame: timeline.at(frame / timeline.fps)
