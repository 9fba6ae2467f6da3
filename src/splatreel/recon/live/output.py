"""Into a live reel, whose layers are retired at a time that is known when they are born."""

from __future__ import annotations

import numpy as np

from splatreel.recon.encode.output import ReelOutput
from splatreel.recon.live.renewal import EPOCH, retired_at
from splatreel.recon.live.spans import LiveSpans
from splatreel.recon.run.store import Store
from splatreel.scene.gaussians import Gaussians


class LiveOutput(ReelOutput):
    """As `ReelOutput`, but for that."""

    def add_layer(
        self, group: int, first_frame: int, points: Gaussians, importance: np.ndarray | None
    ) -> tuple[Gaussians, np.ndarray]:
        return self.writer.add_layer(group, first_frame, points, importance, until=retired_at(group))

    def restore_layers(self, store: Store, first: int, spans: LiveSpans) -> None:
        """Before the first group that is kept: the layers of earlier ones that it shows."""
        for index in range(first // EPOCH * EPOCH, first):
            layer = store.group(index).layer()
            if layer is not None and not self.writer.manifest.groups:
                self.add_layer(index, spans.span(index).first, layer.trained, layer.importance)
            self.publisher.skip(index)

    def restore(self, index: int, last: bool) -> None:
        if index >= self.writer.manifest.first_group:
            super().restore(index, last)
