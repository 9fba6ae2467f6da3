"""Finished groups into a reel, one after the other, from their checkpoints."""

from __future__ import annotations

import dataclasses
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch

from splatreel.codec.predictive.precision import Steps
from splatreel.codec.writer import ReelWriter
from splatreel.recon.encode.importance import Importance, group_importance
from splatreel.recon.run.store import Store, StoredGroup, StoredLayer
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

MAX_WORKERS = 8
"""Groups encoded at a time: each is held in memory."""

Present = Callable[[ReelWriter, int | None], None]
"""What a reel has beside its points, such as a poster, is added by what is called after each group with the group's index, and at
the end, before the reel is declared complete, with None."""


def nothing_more(writer: ReelWriter, group: int | None) -> None:
    """Adds nothing."""


@dataclass(frozen=True)
class Ready:
    """A group that is about to be encoded, with what its steps hang on, and the layers born at it, which are encoded."""

    group: Group
    importance: np.ndarray | None
    steps: Steps
    layers: list[ReadyLayer]


@dataclass(frozen=True)
class ReadyLayer:
    """An encoded layer, and the order of its points. until: the group at which it is retired; None: never."""

    points: Gaussians
    data: bytes
    order: np.ndarray
    until: int | None


class Publisher:
    """Encodes finished groups from their checkpoints, in order from the first.

    encoded: take the files that chapters have encoded already, whose settings they are. device: where importance is measured that no
    checkpoint has. measured: that importance by group, kept from trial to trial.
    """

    def __init__(
        self,
        writer: ReelWriter,
        store: Store,
        device: torch.device,
        measured: dict[int, Importance] | None = None,
        encoded: bool = False,
    ) -> None:
        self.writer, self.store, self.device, self.encoded = writer, store, device, encoded
        self.measured = {} if measured is None else measured
        self._firsts = store.chapter_firsts()
        self._shared = self._order = np.zeros(0, np.int64)

    def publish(self, index: int) -> None:
        ready = self._prepare(index)
        self._write(ready, self.store.group(index).encoded_group() if self.encoded else None)

    def publish_all(self, count: int, done: Callable[[int], None]) -> None:
        """The first `count` groups; several are encoded at a time, in threads, by the predictive codec. done: called with how many."""
        workers = min(os.cpu_count() or 1, MAX_WORKERS) if self.writer.config.codec == "predictive" else 1
        waiting: deque[tuple[Ready, Future[dict[str, bytes]]]] = deque()
        with ThreadPoolExecutor(workers) as pool:
            for index in range(count):
                ready = self._prepare(index)
                files = pool.submit(self.writer.encoder.group, ready.group, ready.importance, ready.steps)
                waiting.append((ready, files))
                while len(waiting) > (workers if index + 1 < count else 0):
                    before, files = waiting.popleft()
                    self._write(before, files.result())
                    done(before.group.index + 1)

    def skip(self, index: int) -> None:
        """A group that the reel holds already, in the order of its checkpoint."""
        for shared, layer in self._born(index):
            self._extend(np.arange(len(layer.trained)), shared)

    def _prepare(self, index: int) -> Ready:
        stored = self.store.group(index).group()
        group = stored.group
        born = self._born(index)
        moving, resting = self._importance(stored, [layer for _, layer in born])
        layers = []
        for shared, layer in born:
            known = layer.importance
            if known is None and resting is not None:
                known = resting[len(self._order) : len(self._order) + len(layer.trained)]
            layers.append(self._ready(index, group.first_frame, layer, known, shared))
            self._extend(layers[-1].order, shared)
        # The alive bits count in the order that training saw; another encoder may have put the points into another order.
        group = dataclasses.replace(group, alive=group.alive[self._order])
        return Ready(group, moving, stored.steps, layers)

    def _born(self, index: int) -> list[tuple[bool, StoredLayer]]:
        """The layers born at a group, each with whether all chapters share it. Those of the chapter before are retired at its end."""
        own, shared = self.store.group(index).layer(), None
        if self._firsts is not None and index in self._firsts:
            self._order = self._shared
            shared = self.store.scene.layer() if index == 0 else None
        return [(s, layer) for s, layer in ((True, shared), (False, own)) if layer is not None and len(layer.trained)]

    def _extend(self, order: np.ndarray, shared: bool) -> None:
        self._order = np.concatenate([self._order, len(self._order) + order])
        if shared:
            self._shared = self._order

    def _ready(
        self, index: int, first_frame: int, layer: StoredLayer, importance: np.ndarray | None, shared: bool
    ) -> ReadyLayer:
        until = None if shared or self._firsts is None else min((f for f in self._firsts if f > index), default=None)
        store = self.store.scene if shared else self.store.group(index)
        data = store.encoded_layer() if self.encoded else None
        if data is not None:
            return ReadyLayer(layer.trained, data, np.arange(len(layer.trained)), until)
        encoded = self.writer.encoder.layer(index, first_frame, layer.trained, importance, layer.steps)
        return ReadyLayer(layer.trained, *encoded, until)

    def _importance(self, stored: StoredGroup, born: list[StoredLayer]) -> Importance:
        """As the run measured it, or measured now."""
        if stored.importance is not None and all(layer.importance is not None for layer in born):
            return stored.importance, None
        index = stored.group.index
        if index not in self.measured:
            static = self.store.static(index)
            reel = self.writer.manifest, self.writer.config
            self.measured[index] = group_importance(*reel, static, stored.group, self.device)
        return self.measured[index]

    def _write(self, ready: Ready, files: dict[str, bytes] | None) -> None:
        group = ready.group
        for layer in ready.layers:
            encoded = layer.data, layer.order
            self.writer.add_layer(group.index, group.first_frame, layer.points, encoded=encoded, until=layer.until)
        self.writer.add_group(group, encoded=files or self.writer.encoder.group(group, ready.importance, ready.steps))
