"""A reconstruction before it was encoded: what the cost of compression is measured against."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.recon.run.store import Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


class UncompressedReel:
    """The reconstruction as it was before any encoding, in the shape of a reel reader."""

    def __init__(self, work: Path, reel: Path) -> None:
        reader = ReelReader(reel)
        self.store = Store(work)
        self.manifest: Manifest = reader.manifest
        self.fps, self.frames, self.duration, self.name = reader.fps, reader.frames, reader.duration, str(work)

    def group(self, index: int) -> Group:
        return self.store.group(index).group().group

    def static(self, group: int) -> tuple[Gaussians, np.ndarray]:
        """The static points that `alive` of a group speaks of, as trained, and the group each was born at."""
        layers = self.store.layers(group)
        if not layers:
            return Gaussians.empty(0), np.zeros(0, np.int64)
        born = np.repeat([birth for birth, _ in layers], [len(layer.trained) for _, layer in layers])
        return Gaussians.concatenate([layer.trained for _, layer in layers]), born
