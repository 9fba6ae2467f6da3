"""Destination of finished layers and groups: the reel, or the checkpoints of a chapter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property

from splatreel.codec.encoder import ReelEncoder
from splatreel.codec.header import ReelHeader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.method.encode.compression import Coding, CompressedGroup, CompressedLayer
from splatreel.run.output.group_writer import GroupWriter, PresentationHook
from splatreel.run.store import Store, StoredGroup, StoredLayer
from splatreel.scene.group import Group


class Output(ABC):
    """Destination of a run's layers and groups. It saves them as checkpoints and writes their files."""

    def __init__(self, store: Store, header: ReelHeader, encoder: ReelEncoder) -> None:
        self.store = store
        self.header = header
        self.encoder = encoder

    @cached_property
    def coding(self) -> Coding:
        """Encoder, and the properties of the run that it depends on."""
        return Coding(self.encoder, self.header, self.store.trial())

    def add_layer(self, layer: CompressedLayer) -> None:
        """Add a layer."""
        self._write_layer(layer)
        stored = StoredLayer(layer.trained, layer.decoded, layer.importance, layer.steps)
        self.store.group(layer.group).save_layer(stored)

    def add_group(self, found: CompressedGroup) -> None:
        """Add a group. It is saved before it is written: a group that a reel holds is never trained again."""
        stored = StoredGroup(found.group, found.importance, found.steps)
        self.store.group(found.group.index).save_group(stored)
        self._write_group(found.group, found.files)

    @abstractmethod
    def restore(self, index: int, last: bool) -> None:
        """Add a group that an earlier run finished, if it is missing here.

        Args:
            index: Number of the group.
            last: No later group was finished.
        """

    @abstractmethod
    def _write_layer(self, layer: CompressedLayer) -> None:
        """Write the files of a layer."""

    @abstractmethod
    def _write_group(self, group: Group, files: dict[str, bytes]) -> None:
        """Write the files of a group."""


class ReelOutput(Output):
    """Output to a reel.

    Attributes:
        group_writer: Writer of groups that an earlier run finished.
    """

    def __init__(self, writer: ReelWriter, group_writer: GroupWriter, present: PresentationHook) -> None:
        super().__init__(group_writer.store, writer.manifest, writer.encoder)
        self.writer = writer
        self.group_writer = group_writer
        self.present = present

    def restore(self, index: int, last: bool) -> None:
        """See `Output`."""
        if index < self.writer.manifest.end_group:
            self.group_writer.skip(index)
        else:
            self.group_writer.write(index)
        if last:
            self.present(self.writer, index)

    def _write_layer(self, layer: CompressedLayer) -> None:
        self.writer.add_layer(layer.group, layer.first_frame, layer.trained, encoded=layer.encoded)

    def _write_group(self, group: Group, files: dict[str, bytes]) -> None:
        self.writer.add_group(group, encoded=files)
        self.present(self.writer, group.index)


class RegionOutput(ReelOutput):
    """Output to a reel that holds a region only. It writes finished groups, with their layers, from their checkpoints."""

    def _write_layer(self, layer: CompressedLayer) -> None:
        """Write nothing."""

    def _write_group(self, group: Group, files: dict[str, bytes]) -> None:
        self.group_writer.write(group.index)
        self.present(self.writer, group.index)


def ignore_group(group: int) -> None:
    """Ignore a finished group."""


class ChapterOutput(Output):
    """Output of encoded files to the checkpoints of a chapter.

    Chapters are made in any order, on any machine. A later job writes the reel.

    Attributes:
        after_group: Called with the index of each finished group.
    """

    def __init__(
        self, store: Store, header: ReelHeader, config: EncodeConfig, after_group: Callable[[int], None] = ignore_group
    ) -> None:
        super().__init__(store, header, ReelEncoder(config, header.cameras))
        self.after_group = after_group

    def restore(self, index: int, last: bool) -> None:
        """See `Output`."""
        if not self.store.group(index).has_encoded_group():
            stored = self.store.group(index).group()
            self._write_group(stored.group, self.encoder.group(stored.group, stored.importance, stored.steps))

    def _write_layer(self, layer: CompressedLayer) -> None:
        self.store.group(layer.group).save_encoded_layer(layer.files)

    def _write_group(self, group: Group, files: dict[str, bytes]) -> None:
        self.store.group(group.index).save_encoded_group(files)
        self.after_group(group.index)
