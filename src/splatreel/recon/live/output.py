"""Into a live reel, whose layers are retired at a time that is known when they are born."""

from __future__ import annotations

from splatreel.recon.encode.output import EncodedLayer, ReelOutput
from splatreel.recon.live.renewal import EPOCH, retired_at
from splatreel.recon.live.spans import LiveSpans
from splatreel.recon.run.store import Store
from splatreel.scene.gaussians import Gaussians


class LiveOutput(ReelOutput):
    """As `ReelOutput`, but for that."""

    def add_layer(self, group: int, first_frame: int, points: Gaussians, encoded: EncodedLayer) -> Gaussians:
        return self.writer.add_layer(group, first_frame, points, encoded=encoded, until=retired_at(group))[0]

    def restore_layers(self, store: Store, first: int, spans: LiveSpans) -> None:
        """Before the first group that is kept: the layers of earlier ones that it shows."""
        for index in range(first // EPOCH * EPOCH, first):
            layer = store.group(index).layer()
            if layer is not None and not self.writer.manifest.groups:
                frame, points = spans.span(index).first, layer.trained
                encoded = self.encoder.layer(index, frame, points, layer.importance, layer.steps)
                self.add_layer(index, frame, points, encoded)
            self.publisher.skip(index)

    def restore(self, index: int, last: bool) -> None:
        if index >= self.writer.manifest.first_group:
            super().restore(index, last)
