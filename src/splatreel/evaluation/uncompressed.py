"""Gaussians of a run before encoding, the reference for coding loss."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np

from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.play.timeline import Timeline
from splatreel.run.store import Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


class UncompressedReel:
    """Checkpoints in the shape of a reel reader, to measure the cost of compression."""

    def __init__(self, work: Path, reel: Path) -> None:
        reader = ReelReader(reel)
        self.store = Store(work)
        self.manifest: Manifest = reader.manifest
        self.fps = reader.fps
        self.frames = reader.frames
        self.duration = reader.duration
        self.name = str(work)

    def group(self, index: int) -> Group:
        """Return a group as trained."""
        return self.store.group(index).group().group

    def static(self, group: int) -> tuple[Gaussians, np.ndarray]:
        """Return the static points that `alive` of a group refers to, as trained, and the group at which each was born."""
        layers = self.store.layers(group)
        if not layers:
            return Gaussians.empty(0), np.zeros(0, np.int64)
        born = np.repeat([birth for birth, _ in layers], [len(layer.trained) for _, layer in layers])
        return Gaussians.concatenate([layer.trained for _, layer in layers]), born


def uncompressed_frames(work: Path, reel: Path) -> Callable[[int], Gaussians]:
    """Return a function from a frame to all Gaussians visible at it, from the checkpoints in `work` instead of the reel's files.

    Raises:
        ReconstructionError: A checkpoint is missing or damaged.
    """
    timeline = Timeline(cast(ReelReader, UncompressedReel(work, reel)))
    return lambda frame: timeline.at(frame / timeline.fps)
