"""Into a live reel, whose layers are retired at a time that is known when they are born."""

from __future__ import annotations

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.config import EncodeConfig
from splatreel.recon.encode.output import ReelOutput
from splatreel.recon.live.renewal import EPOCH, retired_at
from splatreel.recon.live.spans import LiveSpans
from splatreel.recon.run.store import Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


class LiveOutput:
    """As `ReelOutput`, but for that."""

    def __init__(self, reel: ReelOutput) -> None:
        self.reel = reel

    @property
    def header(self) -> ReelHeader:
        return self.reel.header

    @property
    def config(self) -> EncodeConfig:
        return self.reel.config

    def add_layer(
        self, group: int, first_frame: int, points: Gaussians, importance: np.ndarray | None
    ) -> tuple[Gaussians, np.ndarray]:
        return self.reel.writer.add_layer(group, first_frame, points, importance, until=retired_at(group))

    def add_group(self, group: Group, importance: np.ndarray | None) -> None:
        self.reel.add_group(group, importance)

    def restore_layers(self, store: Store, first: int, spans: LiveSpans) -> None:
        """Before the first group that is kept: the layers of earlier ones that it shows."""
        for index in range(first // EPOCH * EPOCH, first):
            layer = store.group(index).layer()
            if layer is not None and not self.reel.writer.manifest.groups:
                begin, importance = spans.span(index).first, layer.importance
                self.reel.writer.add_layer(index, begin, layer.trained, importance, until=retired_at(index))
            self.reel.publisher.skip(index)

    def restore(self, index: int, last: bool) -> None:
        if index >= self.reel.writer.manifest.first_group:
            self.reel.restore(index, last)
