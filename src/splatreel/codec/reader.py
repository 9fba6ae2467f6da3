"""Reader of reels from a directory, over HTTP or from a bucket. The content is untrusted."""

from __future__ import annotations

import hashlib
import time
from collections import OrderedDict
from pathlib import Path
from typing import overload

import numpy as np

from splatreel.base.errors import ReelError, UsageError
from splatreel.codec.group_file import decode_group, decode_layer
from splatreel.codec.manifest import MANIFEST, MAX_BYTES, Fetch, FileEntry, Manifest, parse_manifest
from splatreel.codec.presentation import Asset
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.storage import web
from splatreel.storage.address import Address, is_url, local_path

_CACHED_STATIC = 2
"""Static points are cached for two groups, because an overlap shows both."""
_CACHED_GROUPS = 3
"""An overlap shows two groups; one more makes stepping back and forth over a border fast."""


@overload
def find_reel(path: Path) -> Path: ...


@overload
def find_reel(path: str | Path) -> str | Path: ...


def find_reel(path: str | Path) -> str | Path:
    """Return the folder of a reel, also for the output folder of `reconstruct` or `demo`. A URL is returned as it is."""
    if isinstance(path, str) and is_url(path):
        return path
    folder = Path(path)
    inside = folder / "reel"
    return inside if not (folder / MANIFEST).exists() and (inside / MANIFEST).exists() else folder


def reel_address(location: str | Path) -> Address:
    """Return the address of a reel at a folder, a manifest.json, or a URL of either. Its methods raise `ReelError`.

    Raises:
        ReelError: The address is invalid.
        MissingDependencyError: A required Python package is not installed.
    """
    try:
        path = local_path(location)
        if path is not None:
            return Address(path.parent if path.name == MANIFEST else path, ReelError)
        url, mark, query = str(location).partition("?")
        return Address(url.removesuffix(MANIFEST) + mark + query, ReelError)
    except UsageError as error:
        raise ReelError(str(error)) from error


def _within_patience(address: Address) -> Fetch:
    """Return `address.fetch` with a common deadline of `web.PATIENCE` for all files, against servers that send very slowly."""
    end = time.monotonic() + web.PATIENCE

    def fetch(uri: str, most: int) -> bytes:
        if time.monotonic() > end:
            raise ReelError(
                f"{address.name(uri)}: was not requested, because earlier files took {web.PATIENCE:.0f} s. Try again."
            )
        return address.fetch(uri, most)

    return fetch


class ReelReader:
    """Open reel. Files are read on demand, checked against the manifest, and decoded.

    Args:
        location: Directory, manifest.json, or URL of either (`Address`).
        rendition: Name of a rendition; None chooses the best. `manifest` is then that of this rendition alone.
        most: Memory in bytes that decoding one file may take; None uses `budget.allowed_memory`.

    Raises:
        ReelError: The location is not a reel.
    """

    def __init__(self, location: str | Path, rendition: str | None = None, most: int | None = None) -> None:
        self._most = most
        self._address = reel_address(location)
        self._rendition = rendition
        self.manifest = self._read_manifest()
        self._layers: dict[str, Gaussians] = {}
        self._static: OrderedDict[tuple[int, ...], tuple[Gaussians, np.ndarray]] = OrderedDict()
        self._groups: OrderedDict[int, Group] = OrderedDict()

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self.manifest.fps

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.manifest.frames

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the end of the last frame."""
        return self.frames / self.fps

    def forget(self) -> None:
        """Drop decoded data."""
        self._layers.clear()
        self._groups.clear()
        self._static.clear()

    def layer(self, index: int) -> Gaussians:
        """Return the static points of layers[index] of the manifest, in reel order."""
        entry = self.manifest.layers[index]
        if entry.sha256 not in self._layers:
            name = self._address.name(entry.uri)
            header, gaussians = decode_layer(self.read_file(entry), name, self._most)
            found = (header.index, header.points, header.first_frame)
            self._check_same(name, found, (entry.group, entry.points, entry.first_frame))
            self._check_degree(name, gaussians)
            self._layers[entry.sha256] = gaussians
        return self._layers[entry.sha256]

    def static(self, group: int) -> tuple[Gaussians, np.ndarray]:
        """Return the static points of the layers that live at a group, alive or not, and the group [S] at which each was born."""
        living = tuple(self.manifest.living_layers(group))
        if living not in self._static:
            entries = [self.manifest.layers[index] for index in living]
            layers = [self.layer(index) for index in living]
            points = Gaussians.concatenate(layers) if layers else Gaussians.empty(0)
            born = np.repeat([entry.group for entry in entries], [len(layer) for layer in layers])
            self._static[living] = points, born.astype(np.int64)
            if len(self._static) > _CACHED_STATIC:
                self._static.popitem(last=False)
            self._forget_retired()
        self._static.move_to_end(living)
        return self._static[living]

    def _forget_retired(self) -> None:
        """Drop retired layers that no cached group shows, because a reel may last for hours."""
        shown = {index for living in self._static for index in living}
        kept = {e.sha256 for index, e in enumerate(self.manifest.layers) if e.until is None or index in shown}
        self._layers = {digest: layer for digest, layer in self._layers.items() if digest in kept}

    def group(self, index: int) -> Group:
        """Return a group by its number. The first group's number is the manifest's `first_group`."""
        try:
            entry = self.manifest.group_entry(index)
        except ReelError as error:
            raise ReelError(f"{self.name}: {error}") from error
        if index not in self._groups:
            self._groups[index] = self._load_group(entry)
            if len(self._groups) > _CACHED_GROUPS:
                self._groups.popitem(last=False)
        self._groups.move_to_end(index)
        return self._groups[index]

    def read_file(self, entry: FileEntry | Asset) -> bytes:
        """Return the bytes of a file. Raise `ReelError` if length or digest differ from the manifest."""
        name = self._address.name(entry.uri)
        try:
            data = self._address.fetch(entry.uri, entry.bytes, entry.bytes)
        except ReelError as error:
            if self.manifest.live:
                raise ReelError(f"{error} A live reel drops old files: open it again.") from error
            raise
        if len(data) != entry.bytes:
            raise ReelError(f"{name}: has {len(data)} bytes, the manifest says {entry.bytes}. Copy the reel again.")
        if hashlib.sha256(data).hexdigest() != entry.sha256:
            raise ReelError(f"{name}: its sha256 is not the manifest's: the file is damaged. Copy the reel again.")
        return data

    @property
    def name(self) -> str:
        """Name of the reel for messages."""
        return self._address.name(MANIFEST)

    @property
    def folder(self) -> str:
        """Folder or address of the reel."""
        return self.name.removesuffix(MANIFEST).rstrip("/\\") or "."

    def _read_manifest(self) -> Manifest:
        manifest = self._joined_manifest()
        if self._rendition is None:
            return manifest
        try:
            return manifest.select_rendition(self._rendition)
        except ReelError as error:
            raise ReelError(f"{self.name}: {error}") from error

    def _joined_manifest(self, tries: int = 3) -> Manifest:
        """Read the manifest with its pages. A live reel may drop a page meanwhile; then its newer manifest is read."""
        data = self._address.fetch(MANIFEST, MAX_BYTES)
        try:
            return parse_manifest(data, self.name, _within_patience(self._address))
        except ReelError:
            if tries > 1 and self._address.fetch(MANIFEST, MAX_BYTES) != data:
                return self._joined_manifest(tries - 1)
            raise

    def _load_group(self, entry: FileEntry) -> Group:
        name = self._address.name(entry.uri)
        group = decode_group(self.read_file(entry), name, self._most)
        found = (group.index, len(group.dynamic), group.first_frame, group.frames)
        self._check_same(name, found, (entry.group, entry.points, entry.first_frame, entry.frames))
        self._check_degree(name, group.dynamic)
        static = self.manifest.static_points(entry.group)
        if len(group.alive) != static:
            raise ReelError(
                f"{name}: section 'alive' holds {len(group.alive)} bits, the layers that live at the group {static} points."
            )
        return group

    def _check_same(self, name: str, found: tuple[int, ...], said: tuple[int, ...]) -> None:
        if found != said:
            raise ReelError(f"{name}: has (index, points, first frame, ...) {found}, the manifest says {said}.")

    def _check_degree(self, name: str, points: Gaussians) -> None:
        if points.sh_degree > self.manifest.sh_degree:
            raise ReelError(
                f"{name}: has SH degree {points.sh_degree}, above the manifest's {self.manifest.sh_degree}."
            )
