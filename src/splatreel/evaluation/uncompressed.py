"""A reconstruction before it was encoded: what the cost of compression is measured against."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

from splatreel.codec.reader import ReelReader
from splatreel.play.timeline import Timeline
from splatreel.recon.encode.uncompressed import UncompressedReel
from splatreel.scene.gaussians import Gaussians


def uncompressed_frames(work: Path, reel: Path) -> Callable[[int], Gaussians]:
    """frame -> everything visible at it, from the checkpoints in work instead of the files of the reel made from them.

    Raises `ReconstructionError` for checkpoints that are missing or damaged.
    """
    timeline = Timeline(cast(ReelReader, UncompressedReel(work, reel)))
    return lambda frame: timeline.at(frame / timeline.fps)
