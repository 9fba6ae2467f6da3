"""Writing of a reel from checkpoints: its header, then finished groups in order."""

from __future__ import annotations

import dataclasses
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.predictive.precision import Steps
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config, EncodeConfig
from splatreel.method.encode.compression import Importance, group_importance
from splatreel.method.init.layout import Layout
from splatreel.run.output.sound_output import write_soundtrack
from splatreel.run.store import Store, StoredGroup, StoredLayer
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.scene.reel_source import ReelSource
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


MAX_WORKERS = 8
"""Maximum number of groups encoded at a time. Each is held in memory."""

PresentationHook = Callable[[ReelWriter, int | None], None]
"""Hook that adds content beside the points, such as a poster. It is called with a group's index after each group, and with
None at the end, before the reel is declared complete."""


def no_presentation(writer: ReelWriter, group: int | None) -> None:
    """Add nothing."""


@dataclass(frozen=True)
class PreparedGroup:
    """A group to be encoded, and the encoded layers that are born at it."""

    group: Group
    importance: np.ndarray | None
    steps: Steps
    layers: list[PreparedLayer]


@dataclass(frozen=True)
class PreparedLayer:
    """The files of an encoded layer, and the order of its points. until: the group at which the layer is retired; None if never."""

    points: Gaussians
    files: tuple[bytes, ...]
    order: np.ndarray
    until: int | None


class GroupWriter:
    """Writer of finished groups from checkpoints, in order from the first.

    Attributes:
        measured: Importance measured here, by group. Another writer of the same store can reuse it.
        encoded: Write the files that chapters encoded, instead of encoding again. The files of a region are encoded again.
    """

    def __init__(
        self,
        writer: ReelWriter,
        store: Store,
        measured: dict[int, Importance] | None = None,
        encoded: bool = False,
    ) -> None:
        self.writer = writer
        self.store = store
        self.measured = {} if measured is None else measured
        self._firsts = store.chapter_firsts()
        self._shared = self._order = np.zeros(0, np.int64)
        self._shared_count = self._count = 0
        self._region = region_of(store, writer.manifest)
        self.encoded = encoded and self._region.volume is None

    def write(self, index: int) -> None:
        """Write a group."""
        prepared = self._prepare(index)
        self._write(prepared, self.store.group(index).encoded_group() if self.encoded else None)

    def write_all(self, count: int, done: Callable[[int], None]) -> None:
        """Write the first `count` groups. The predictive codec encodes several at a time, in threads.

        Args:
            count: Number of groups.
            done: Called with the number of groups written so far.
        """
        workers = min(os.cpu_count() or 1, MAX_WORKERS) if self.writer.config.codec == "predictive" else 1
        waiting: deque[tuple[PreparedGroup, Future[dict[str, bytes]]]] = deque()
        with ThreadPoolExecutor(workers) as pool:
            for index in range(count):
                prepared = self._prepare(index)
                files = pool.submit(self.writer.encoder.group, prepared.group, prepared.importance, prepared.steps)
                waiting.append((prepared, files))
                while len(waiting) > (workers if index + 1 < count else 0):
                    before, files = waiting.popleft()
                    self._write(before, files.result())
                    done(before.group.index + 1)

    def skip(self, index: int) -> None:
        """Pass over a group that the reel contains already."""
        if self._is_reordered(index):
            self._prepare(index)
            return
        for shared, layer in self._layers_born_at(index):
            self._extend(np.flatnonzero(self._region.of_layer(layer)), len(layer.trained), shared)

    def _is_reordered(self, index: int) -> bool:
        """Return True if the reel's points may be in another order than the checkpoint's.

        A region has a grid of positions of its own, and an older checkpoint has its layers in one part.
        """
        born = [layer.until for layer in self.writer.manifest.layers if layer.group == index]
        has_parts = len(set(born)) < len(born)
        return (has_parts or self._region.volume is not None) and self.store.group(index).finished()

    def _prepare(self, index: int) -> PreparedGroup:
        stored = self.store.group(index).group()
        born = self._layers_born_at(index)
        moving, of_static = self._importance(stored, [layer for _, layer in born])
        layers = []
        for shared, layer in born:
            known = layer.importance
            if known is None and of_static is not None:
                known = of_static[self._count : self._count + len(layer.trained)]
            kept = self._region.of_layer(layer)
            order = np.zeros(0, np.int64)
            if kept.any():
                part = kept_layer(replace(layer, importance=known), kept)
                layers.append(self._prepare_layer(index, stored.group.first_frame, part, shared))
                order = np.flatnonzero(kept)[layers[-1].order]
            self._extend(order, len(kept), shared)
        stored = self._region.group(replace(stored, importance=moving))
        group, moving = stored.group, stored.importance
        # The alive bits are in the order of training; another encoder may order the points differently.
        group = dataclasses.replace(group, alive=group.alive[self._order])
        return PreparedGroup(group, moving, stored.steps, layers)

    def _layers_born_at(self, index: int) -> list[tuple[bool, StoredLayer]]:
        """Return the layers born at a group, each with a flag: shared by all chapters."""
        own, shared = self.store.group(index).layer(), None
        if self._firsts is not None and index in self._firsts:
            # the previous chapter's layers retire here
            self._order = self._shared
            self._count = self._shared_count
            shared = self.store.scene.layer() if index == 0 else None
        return [(s, layer) for s, layer in ((True, shared), (False, own)) if layer is not None and len(layer.trained)]

    def _extend(self, order: np.ndarray, count: int, shared: bool) -> None:
        """Add a layer of `count` trained points, of which the reel has those in `order`."""
        self._order = np.concatenate([self._order, self._count + order])
        self._count += count
        if shared:
            self._shared = self._order
            self._shared_count = self._count

    def _prepare_layer(self, index: int, first_frame: int, layer: StoredLayer, shared: bool) -> PreparedLayer:
        until = None if shared or self._firsts is None else min((f for f in self._firsts if f > index), default=None)
        store = self.store.scene if shared else self.store.group(index)
        files = store.encoded_layer() if self.encoded else None
        if files is not None:
            return PreparedLayer(layer.trained, files, np.arange(len(layer.trained)), until)
        encoded = self.writer.encoder.layer(index, first_frame, layer.trained, layer.importance, layer.steps)
        return PreparedLayer(layer.trained, *encoded, until)

    def _importance(self, stored: StoredGroup, born: list[StoredLayer]) -> Importance:
        """Return the importance that the run measured, or measure it now."""
        if stored.importance is not None and all(layer.importance is not None for layer in born):
            return stored.importance, None
        index = stored.group.index
        if index not in self.measured:
            static = self.store.static(index)
            reel = self.writer.manifest, self.writer.config
            self.measured[index] = group_importance(*reel, static, stored.group)
        return self.measured[index]

    def _write(self, prepared: PreparedGroup, files: dict[str, bytes] | None) -> None:
        group = prepared.group
        for layer in prepared.layers:
            encoded = layer.files, layer.order
            self.writer.add_layer(group.index, group.first_frame, layer.points, encoded=encoded, until=layer.until)
        self.writer.add_group(
            group, encoded=files or self.writer.encoder.group(group, prepared.importance, prepared.steps)
        )


def region_of(store: Store, header: ReelHeader) -> Region:
    """Return the part of a run that its reel holds."""
    layout = store.layout()
    return Region(None if layout is None else layout.volume(header.cameras))


def bounds_of(layout: Layout, cameras: list[Camera]) -> np.ndarray:
    """Return the box of the reel's content, [2, 3]: that of the scene, within the region."""
    bounds = np.array(layout.bounds)
    volume = layout.volume(cameras)
    box = None if volume is None else volume.bounds()
    if box is None:
        return bounds
    inner = np.stack([np.maximum(bounds[0], box[0]), np.minimum(bounds[1], box[1])])
    return inner if (inner[0] < inner[1]).all() else box


def header_of(
    cameras: list[Camera], fps: float, config: Config, layout: Layout, source: ReelSource | None = None
) -> ReelHeader:
    """Create the header of a reel by its training cameras. `source`: frames and cameras of the capture; None if unknown."""
    if source is not None and layout.region and source.part is None:
        source = replace(source, part="region")
    return ReelHeader(
        fps=fps,
        group_length=config.group.length,
        overlap=config.group.overlap,
        sh_degree=config.keyframe.sh_degree,
        bounds=bounds_of(layout, cameras),
        up=np.array(layout.up),
        camera=cameras[len(cameras) // 2],
        cameras=cameras,
        near=layout.near,
        clearance=layout.clearance,
        antialias=config.antialias,
        background=layout.background,
        transparent=layout.is_partial,
        source=source,
    )


def open_writer(
    store: Store, reel: Path, config: EncodeConfig, resume: bool, first_group: int | None = None
) -> ReelWriter:
    """Create the writer of a reconstruction's reel, and add its soundtrack. `resume` continues a reel that exists already.

    Raises:
        ReconstructionError: If the store has no header.
    """
    header, limits = store.header()
    writer = ReelWriter(reel, header, config=config, resume=resume, first_group=first_group)
    if limits != writer.manifest.presentation.limits:
        writer.present(dataclasses.replace(writer.manifest.presentation, limits=limits))
    write_soundtrack(store.work, writer)
    return writer
