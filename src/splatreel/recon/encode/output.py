"""Where layers and groups go as soon as they are made: into the reel, or, of a chapter, beside its checkpoints."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from splatreel.codec.encoder import ReelEncoder
from splatreel.codec.group_file import decode_layer
from splatreel.codec.header import ReelHeader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.recon.encode.publisher import Present, Publisher
from splatreel.recon.run.store import Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

EncodedLayer = tuple[bytes, np.ndarray]
"""A layer's file, and the order [N] of its points: which of those given each of them was."""


class Output(Protocol):
    """What a run hands its layers and groups to. header, encoder: what the reel says, and how it is encoded."""

    @property
    def header(self) -> ReelHeader: ...

    @property
    def encoder(self) -> ReelEncoder: ...

    def add_layer(self, group: int, first_frame: int, points: Gaussians, encoded: EncodedLayer) -> Gaussians:
        """The points decoded, in reel order. encoded: what `encoder.layer` gave for them."""
        ...

    def add_group(self, group: Group, encoded: dict[str, bytes]) -> None:
        """encoded: what `encoder.group` gave for it."""
        ...

    def restore(self, index: int, last: bool) -> None:
        """A group that was finished before, and may lack here. last: none follows that was."""
        ...


class ReelOutput:
    """Into the reel at once. present: adds what is there beside the points."""

    def __init__(self, writer: ReelWriter, publisher: Publisher, present: Present) -> None:
        self.writer, self.publisher, self.present = writer, publisher, present

    @property
    def header(self) -> ReelHeader:
        return self.writer.manifest

    @property
    def encoder(self) -> ReelEncoder:
        return self.writer.encoder

    def add_layer(self, group: int, first_frame: int, points: Gaussians, encoded: EncodedLayer) -> Gaussians:
        return self.writer.add_layer(group, first_frame, points, encoded=encoded)[0]

    def add_group(self, group: Group, encoded: dict[str, bytes]) -> None:
        self.writer.add_group(group, encoded=encoded)
        self.present(self.writer, group.index)

    def restore(self, index: int, last: bool) -> None:
        if index < self.writer.manifest.end_group:
            self.publisher.skip(index)
        else:
            self.publisher.publish(index)
        if last:
            self.present(self.writer, index)


def untold(group: int) -> None:
    """Tells nobody."""


class ChapterOutput:
    """Beside the checkpoints, encoded, for whoever writes the reel: chapters are made in any order, on any machine.

    after_group: called with the index of each group that is finished.
    """

    def __init__(
        self, store: Store, header: ReelHeader, config: EncodeConfig, after_group: Callable[[int], None] = untold
    ) -> None:
        self.store, self.header, self.after_group = store, header, after_group
        self.encoder = ReelEncoder(config)

    def add_layer(self, group: int, first_frame: int, points: Gaussians, encoded: EncodedLayer) -> Gaussians:
        self.store.group(group).save_encoded_layer(encoded[0])
        return decode_layer(encoded[0], f"The layer of group {group}")[1]

    def add_group(self, group: Group, encoded: dict[str, bytes]) -> None:
        self.store.group(group.index).save_encoded_group(encoded)
        self.after_group(group.index)

    def restore(self, index: int, last: bool) -> None:
        if not self.store.group(index).has_encoded_group():
            stored = self.store.group(index).group()
            self.add_group(stored.group, self.encoder.group(stored.group, stored.importance, stored.steps))
