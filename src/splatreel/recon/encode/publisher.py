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
    """A group that is about to be encoded, with the importance of its points, and the layer born at it, which is encoded."""

    group: Group
    importance: np.ndarray | None
    layer: Gaussians | None
    encoded: tuple[bytes, np.ndarray] | None


class Publisher:
    """Encodes finished groups from their checkpoints, in order from the first.

    device: where importance is measured that no checkpoint has. measured: that importance by group, kept from trial to trial.
    """

    def __init__(
        self, writer: ReelWriter, store: Store, device: torch.device, measured: dict[int, Importance] | None = None
    ) -> None:
        self.writer, self.store, self.device = writer, store, device
        self.measured = {} if measured is None else measured
        self._order = np.zeros(0, np.int64)

    def publish(self, index: int) -> None:
        self._write(self._prepare(index), None)

    def publish_all(self, count: int, done: Callable[[int], None]) -> None:
        """The first `count` groups; several are encoded at a time, in threads, by the predictive codec. done: called with how many."""
        workers = min(os.cpu_count() or 1, MAX_WORKERS) if self.writer.config.codec == "predictive" else 1
        waiting: deque[tuple[Ready, Future[dict[str, bytes]]]] = deque()
        with ThreadPoolExecutor(workers) as pool:
            for index in range(count):
                ready = self._prepare(index)
                waiting.append((ready, pool.submit(self.writer.encoder.group, ready.group, ready.importance)))
                while len(waiting) > (workers if index + 1 < count else 0):
                    before, files = waiting.popleft()
                    self._write(before, files.result())
                    done(before.group.index + 1)

    def _prepare(self, index: int) -> Ready:
        stored, layer = self.store.group(index).group(), self.store.group(index).layer()
        group = stored.group
        moving, resting = self._importance(stored, layer)
        encoded = None
        if layer is not None:
            born = layer.importance
            if born is None and resting is not None:
                born = resting[-len(layer.trained) :]
            encoded = self.writer.encoder.layer(index, group.first_frame, layer.trained, born)
            self._order = np.concatenate([self._order, len(self._order) + encoded[1]])
        # The alive bits count in the order that training saw; another encoder may have put the points into another order.
        group = dataclasses.replace(group, alive=group.alive[self._order])
        return Ready(group, moving, None if layer is None else layer.trained, encoded)

    def _importance(self, stored: StoredGroup, layer: StoredLayer | None) -> Importance:
        """As the run measured it, or measured now."""
        if stored.importance is not None and (layer is None or layer.importance is not None):
            return stored.importance, None
        index = stored.group.index
        if index not in self.measured:
            static = self.store.static(index)
            self.measured[index] = group_importance(
                self.writer.manifest, self.writer.config, static, stored.group, self.device
            )
        return self.measured[index]

    def _write(self, ready: Ready, files: dict[str, bytes] | None) -> None:
        if ready.layer is not None:
            first = ready.group.first_frame
            self.writer.add_layer(ready.group.index, first, ready.layer, encoded=ready.encoded)
        self.writer.add_group(ready.group, ready.importance, files)

    def skip(self, index: int) -> None:
        """A group that the reel holds already, in the order of its checkpoint."""
        layer = self.store.group(index).layer()
        born = 0 if layer is None else len(layer.trained)
        self._order = np.concatenate([self._order, len(self._order) + np.arange(born)])
