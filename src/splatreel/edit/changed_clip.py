"""Base class of the operations of an edit: clips that change what other clips return."""

from __future__ import annotations

from collections.abc import Callable

from splatreel.edit.clip import Clip, ClipGroup, ClipLayer, Outline


class ChangedClip:
    """Clip that changes what another clip returns. By default nothing changes.

    A long edit is a long chain of such clips. Layers and groups pass through the chain in a loop, so that the depth of
    the call stack does not depend on the number of operations.
    """

    outline: Outline

    def __init__(self, clip: Clip, outline: Outline | None = None) -> None:
        self._clip = clip
        self.outline = clip.outline if outline is None else outline

    def layer_origin(self, index: int) -> tuple[Clip, int]:
        """Return the clip that a layer comes from, and its index there."""
        return self._clip, index

    def group_origin(self, index: int) -> tuple[Clip, int]:
        """Return the clip that a group comes from, and its index there."""
        return self._clip, index

    def change_layer(self, index: int, layer: ClipLayer) -> ClipLayer:
        """Return a layer after the change, from that of its origin."""
        return layer

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group after the change, from that of its origin."""
        return found

    def layer(self, index: int) -> ClipLayer:
        """Return a layer, decoded."""
        chain, clip, at = _origin(self, index, lambda changed, number: changed.layer_origin(number))
        found = clip.layer(at)
        for changed, number in reversed(chain):
            found = changed.change_layer(number, found)
        return found

    def group(self, index: int, rendition: str | None = None) -> ClipGroup:
        """Return a group, decoded; by default the best rendition."""
        chain, clip, at = _origin(self, index, lambda changed, number: changed.group_origin(number))
        found = clip.group(at, rendition)
        for changed, number in reversed(chain):
            found = changed.change_group(number, found)
        return found


def _origin(
    clip: Clip, index: int, origin: Callable[[ChangedClip, int], tuple[Clip, int]]
) -> tuple[list[tuple[ChangedClip, int]], Clip, int]:
    """Return the chain of changes from a clip down, each with the index there, and the unchanged clip with the index there."""
    chain = []
    while isinstance(clip, ChangedClip):
        chain.append((clip, index))
        clip, index = origin(clip, index)
    return chain, clip, index
