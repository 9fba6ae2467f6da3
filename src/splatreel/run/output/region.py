"""Part of a reconstruction that a reel holds: the points within a volume."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splatreel.run.store import StoredGroup, StoredLayer
from splatreel.scene.volumes import Volume


@dataclass(frozen=True)
class Region:
    """Choice of the points whose centers are within a volume.

    Attributes:
        volume: The volume; None keeps all points.
    """

    volume: Volume | None

    def of_layer(self, layer: StoredLayer) -> np.ndarray:
        """Return the points of a layer that are kept, [S] bool."""
        if self.volume is None:
            return np.ones(len(layer.trained), bool)
        return self.volume.contains(layer.trained.means)

    def group(self, stored: StoredGroup) -> StoredGroup:
        """Return a group with the dynamic points that are within the volume at some frame, transparent at the others."""
        if self.volume is None:
            return stored
        group = stored.group
        inside = self.volume.contains(group.dynamic.means + group.dx)
        some = np.asarray(inside.any(0))
        shade = None if group.shade is None else group.shade[:, some]
        group = replace(group, dynamic=group.dynamic[some], dx=group.dx[:, some], dq=group.dq[:, some], shade=shade)
        if not inside[:, some].all():
            group = replace(group, shade=group.shade_where(inside[:, some]))
        importance = None if stored.importance is None else stored.importance[some]
        return replace(stored, group=group, importance=importance)


def kept_layer(layer: StoredLayer, kept: np.ndarray) -> StoredLayer:
    """Return a layer with some of its points, [S] bool."""
    importance = None if layer.importance is None else layer.importance[kept]
    return replace(layer, trained=layer.trained[kept], decoded=layer.decoded[kept], importance=importance)
