"""Destination of finished layers and groups: the reel, or the checkpoints of a chapter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from splatreel.codec.encoder import EncodedLayer, ReelEncoder
from splatreel.codec.group_file import decode_parts
from splatreel.codec.header import ReelHeader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.run.output.group_writer import GroupWriter, PresentationHook
from splatreel.run.store import Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


class Output(Protocol):
    """Destination of a run's layers and groups."""

    @property
    def header(self) -> ReelHeader:
        """Header of the reel."""
        ...

    @property
    def encoder(self) -> ReelEncoder:
        """Encoder of layers and groups."""
        ...

    def add_layer(self, group: int, first_frame: int, points: Gaussians, encoded: EncodedLayer) -> Gaussians:
        """Add a layer and return its points as decoded, in the order of the reel.

        Args:
            group: Group at which the layer is born.
            first_frame: First frame of this group.
            points: Points as trained.
            encoded: Result of `encoder.layer` for these points.
        """
        ...

    def add_group(self, group: Group, encoded: dict[str, bytes]) -> None:
        """Add a group. encoded: result of `encoder.group`."""
        ...

    def restore(self, index: int, last: bool) -> None:
        """Add a group that an earlier run finished, if it is missing here.

        Args:
            index: Number of the group.
            last: No later group was finished.
        """
        ...


class ReelOutput:
    """Output to a reel.

    Attributes:
        writer: Writer of the reel.
        group_writer: Writer of groups that an earlier run finished.
        present: Adds content beside the points, see `PresentationHook`.
    """

    def __init__(self, writer: ReelWriter, group_writer: GroupWriter, present: PresentationHook) -> None:
        """Create an output, see the attributes."""
        self.writer, self.group_writer, self.present = writer, group_writer, present

    @property
    def header(self) -> ReelHeader:
        """See `Output`."""
        return self.writer.manifest

    @property
    def encoder(self) -> ReelEncoder:
        """See `Output`."""
        return self.writer.encoder

    def add_layer(self, group: int, first_frame: int, points: Gaussians, encoded: EncodedLayer) -> Gaussians:
        """See `Output`."""
        return self.writer.add_layer(group, first_frame, points, encoded=encoded)[0]

    def add_group(self, group: Group, encoded: dict[str, bytes]) -> None:
        """See `Output`."""
        self.writer.add_group(group, encoded=encoded)
        self.present(self.writer, group.index)

    def restore(self, index: int, last: bool) -> None:
        """See `Output`."""
        if index < self.writer.manifest.end_group:
            self.group_writer.skip(index)
        else:
            self.group_writer.write(index)
        if last:
            self.present(self.writer, index)


class RegionOutput(ReelOutput):
    """Output to a reel that holds a region only. It writes finished groups from their checkpoints."""

    def add_layer(self, group: int, first_frame: int, points: Gaussians, encoded: EncodedLayer) -> Gaussians:
        """See `Output`. The layer is written with its group."""
        return decode_parts(encoded[0], f"The layer of group {group}")

    def add_group(self, group: Group, encoded: dict[str, bytes]) -> None:
        """See `Output`."""
        self.group_writer.write(group.index)
        self.present(self.writer, group.index)


def ignore_group(group: int) -> None:
    """Ignore a finished group."""


class ChapterOutput:
    """Output of encoded files to the checkpoints of a chapter.

    Chapters are made in any order, on any machine. A later job writes the reel.

    Attributes:
        store: Checkpoints.
        header: Header of the reel.
        encoder: Encoder of layers and groups.
        after_group: Called with the index of each finished group.
    """

    def __init__(
        self, store: Store, header: ReelHeader, config: EncodeConfig, after_group: Callable[[int], None] = ignore_group
    ) -> None:
        """Create an output, see the attributes."""
        self.store, self.header, self.after_group = store, header, after_group
        self.encoder = ReelEncoder(config, header.cameras)

    def add_layer(self, group: int, first_frame: int, points: Gaussians, encoded: EncodedLayer) -> Gaussians:
        """See `Output`."""
        self.store.group(group).save_encoded_layer(encoded[0])
        return decode_parts(encoded[0], f"The layer of group {group}")

    def add_group(self, group: Group, encoded: dict[str, bytes]) -> None:
        """See `Output`."""
        self.store.group(group.index).save_encoded_group(encoded)
        self.after_group(group.index)

    def restore(self, index: int, last: bool) -> None:
        """See `Output`."""
        if not self.store.group(index).has_encoded_group():
            stored = self.store.group(index).group()
            self.add_group(stored.group, self.encoder.group(stored.group, stored.importance, stored.steps))
