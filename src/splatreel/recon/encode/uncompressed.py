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
        """All static points born up to a group, as trained, and the group each was born at."""
        layers = {i: self.store.group(i).layer() for i in range(group + 1)}
        points = {i: layer.trained for i, layer in layers.items() if layer is not None}
        if not points:
            return Gaussians.empty(0), np.zeros(0, np.int64)
        born = np.repeat(list(points), [len(p) for p in points.values()])
        return Gaussians.concatenate(list(points.values())), born
