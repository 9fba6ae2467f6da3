"""The manifest, `manifest.json`, which lists the files of a reel (docs/format.md). The parser accepts untrusted input."""

from __future__ import annotations

import hashlib
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.atomic import sweep, write_bytes
from splatreel.base.errors import ReelError
from splatreel.base.untrusted import read_file
from splatreel.codec.document import in_lines, items, parse_object
from splatreel.codec.header import BLACK, ReelHeader
from splatreel.codec.presentation import (
    EMPTY,
    Asset,
    Presentation,
    check_text,
    parse_digest,
    parse_presentation,
    parse_uri,
)
from splatreel.codec.quantize import MOST_FRAMES, boolean, integer, most_points, number, numbers
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import NONE, Clearance
from splatreel.scene.reel_source import parse_reel_source
from splatreel.storage.address import Address

_MAX_FILE_BYTES = 1 << 30
"""Maximum size of a layer or group file."""
_MAX_FILES = 1 << 20
"""Maximum number of layers, and of groups, in a reel."""
_BIG = 1 << 40
"""Upper bound of frame and group numbers."""


@dataclass(frozen=True)
class FileEntry:
    """Entry of one layer or group file.

    Attributes:
        uri: Path relative to the manifest.
        bytes: Size of the file.
        sha256: Digest of the file, hexadecimal.
        frames: Frames of the group; 0 for a layer.
        group: Number of the group; for a layer, of the group it was born at.
        renditions: The same group in the reel's other renditions, by name.
        until: Group at which a layer is retired, the first that does not show it; None if never.
        overlap: Frames over which a group cross-fades with the one before, 0 for a hard cut; None for the reel's.
    """

    uri: str
    bytes: int
    sha256: str
    first_frame: int
    frames: int
    points: int
    group: int
    renditions: Mapping[str, FileEntry] = field(default_factory=dict)
    until: int | None = None
    overlap: int | None = None

    def lives_at(self, group: int) -> bool:
        """Return whether a group can show this layer's points."""
        return self.group <= group and (self.until is None or group < self.until)

    @property
    def end(self) -> int:
        """Frame after the group's last frame."""
        return self.first_frame + self.frames


def birth_order(layer: FileEntry) -> tuple[int, int]:
    """Return the sort key of layers: birth, then the longest-lived first. A page's layers then end the list of a group."""
    return layer.group, -_BIG if layer.until is None else -layer.until


def _parse_layer(entry: object, index: int, version: int) -> FileEntry:
    """Parse layers[index] of a manifest. Only version 2 has `until`."""
    try:
        common = _common(entry)
        born = integer(common, "group", 0, _BIG)
        until = integer(common, "until", born + 1, _BIG) if version > 1 and "until" in common else None
        return _file(common, 0, born, until)
    except ReelError as error:
        raise ReelError(f"layers[{index}] {error}") from error


def _parse_group(entry: object, index: int, number: int, names: tuple[str, ...]) -> FileEntry:
    """Parse groups[index], the group with the given number, in all renditions.

    Args:
        entry: JSON value.
        index: Position in the list, for messages.
        number: Number of the group.
        names: Names of the renditions. `entry` itself is the first of them.
    """
    try:
        common = _common(entry)
        frames = integer(common, "frames", 1, MOST_FRAMES)
        others = common.get("renditions", {})
        if not isinstance(others, dict) or not all(isinstance(others.get(name), dict) for name in names[1:]):
            raise ReelError(f"lacks one of the renditions {', '.join(names)}.")
        time = {"first_frame": common.get("first_frame")}
        overlap = integer(common, "overlap", 0, _BIG) if "overlap" in common else None
        found = {name: replace(_file(others[name] | time, frames, number), overlap=overlap) for name in names[1:]}
        return replace(_file(common, frames, number, None, found), overlap=overlap)
    except ReelError as error:
        raise ReelError(f"groups[{index}] {error}") from error


def _common(entry: object) -> dict[str, Any]:
    if not isinstance(entry, dict):
        raise ReelError("is not an object.")
    return entry


def _file(
    entry: dict[str, Any],
    frames: int,
    group: int,
    until: int | None = None,
    renditions: Mapping[str, FileEntry] | None = None,
) -> FileEntry:
    size = integer(entry, "bytes", 1, _MAX_FILE_BYTES)
    return FileEntry(
        uri=parse_uri(entry),
        bytes=size,
        sha256=parse_digest(entry),
        first_frame=integer(entry, "first_frame", 0, _BIG),
        frames=frames,
        points=integer(entry, "points", 0, most_points(size)),
        group=group,
        renditions=renditions or {},
        until=until,
    )


def _layer_to_json(entry: FileEntry) -> dict[str, Any]:
    own = {"group": entry.group} | ({} if entry.until is None else {"until": entry.until})
    return _common_fields(entry) | own | {"points": entry.points}


def _group_to_json(entry: FileEntry) -> dict[str, Any]:
    others = {
        name: {"uri": file.uri, "bytes": file.bytes, "sha256": file.sha256, "points": file.points}
        for name, file in entry.renditions.items()
    }
    own = {"frames": entry.frames} | ({} if entry.overlap is None else {"overlap": entry.overlap})
    own["points"] = entry.points
    return _common_fields(entry) | own | ({"renditions": others} if others else {})


def _common_fields(entry: FileEntry) -> dict[str, Any]:
    return {"uri": entry.uri, "bytes": entry.bytes, "sha256": entry.sha256, "first_frame": entry.first_frame}


PAGE = 64
"""Groups per page when writing."""
MAX_PAGE_GROUPS = 1024
"""Maximum groups per page when reading."""
_MAX_PAGES = 1 << 14
MAX_PAGE_BYTES = 1 << 20
_MAX_PAGES_BYTES = 64 << 20
"""Maximum size of all pages together."""
_LAST = 1 << 31
"""Upper bound of frames in pages, and of the number of the first group."""
AT_ONCE = 8
"""Pages fetched in parallel."""

Fetch = Callable[[str, int], bytes]
"""Function that returns the file at a relative URI, given its maximum size. It raises `ReelError` for a missing or longer file."""
Known = dict[tuple[str, int, int, tuple[str, ...]], "Page"]
"""Cache of parsed pages by digest, length, first group and renditions. Pages never change."""


@dataclass(frozen=True)
class PageEntry:
    """Entry of a page in the manifest.

    Attributes:
        uri: Path relative to the manifest.
        bytes: Size of the page.
        sha256: Digest of the page, hexadecimal.
        frames: Frames from `first_frame` to the latest end of its groups.
        groups: Number of groups.
        rendition_bytes: Bytes of its groups by rendition; empty for a single rendition.
    """

    uri: str
    bytes: int
    sha256: str
    first_frame: int
    frames: int
    groups: int
    rendition_bytes: Mapping[str, int] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object that `_parse_page_entries` accepts."""
        document = {name: value for name, value in vars(self).items() if name != "rendition_bytes"}
        return document | ({"rendition_bytes": dict(self.rendition_bytes)} if self.rendition_bytes else {})


@dataclass(frozen=True)
class Page:
    """Groups of a page, and the layers with `until` that live at any of them, in order of birth."""

    layers: tuple[FileEntry, ...]
    groups: tuple[FileEntry, ...]

    def to_bytes(self) -> bytes:
        """Return the content of the file."""
        layers, groups = map(_layer_to_json, self.layers), map(_group_to_json, self.groups)
        return in_lines({"layers": list(layers), "groups": list(groups)}).encode()


def make_page(
    layers: Iterable[FileEntry], groups: Sequence[FileEntry], names: Sequence[str]
) -> tuple[PageEntry, bytes]:
    """Return the manifest entry and the file of a page.

    `names`: Names of the renditions.
    """
    first, last = groups[0].group, groups[-1].group
    data = Page(tuple(_retired_layers(layers, first, last)), tuple(groups)).to_bytes()
    if len(data) > MAX_PAGE_BYTES:
        raise ReelError(f"needs a page of {len(data)} bytes for groups {first} to {last}; {MAX_PAGE_BYTES} are read.")
    entry = PageEntry(
        uri=f"pages/{first:06d}.json",
        bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
        first_frame=groups[0].first_frame,
        frames=max(group.end for group in groups) - groups[0].first_frame,
        groups=len(groups),
        rendition_bytes=rendition_bytes(groups, names),
    )
    return entry, data


def _retired_layers(layers: Iterable[FileEntry], first: int, last: int) -> list[FileEntry]:
    """Return the layers with `until` that live at any of the groups `first` to `last`."""
    return [layer for layer in layers if layer.until is not None and layer.group <= last and first < layer.until]


def rendition_bytes(groups: Iterable[FileEntry], names: Sequence[str]) -> dict[str, int]:
    """Return the bytes of groups by rendition."""
    sizes = dict.fromkeys(names, 0)
    for group in groups:
        for name in names:
            sizes[name] += group.renditions.get(name, group).bytes
    return sizes


def _parse_page_entries(document: Mapping[str, Any], names: Sequence[str]) -> tuple[PageEntry, ...]:
    """Parse the manifest's `pages`. Raise `ReelError` if they are not valid."""
    if "pages" not in document:
        return ()
    entries = items(document, "pages", 0, _MAX_PAGES)
    pages = tuple(_parse_entry(entry, index, names) for index, entry in enumerate(entries))
    if sum(page.bytes for page in pages) > _MAX_PAGES_BYTES:
        raise ReelError(f"has pages of more than the {_MAX_PAGES_BYTES} bytes that all of them may have.")
    if sum(page.groups for page in pages) > _MAX_FILES:
        raise ReelError(f"has pages of more than {_MAX_FILES} groups.")
    return pages


def _parse_entry(entry: object, index: int, names: Sequence[str]) -> PageEntry:
    try:
        if not isinstance(entry, dict):
            raise ReelError("is not an object.")
        sizes = entry.get("rendition_bytes", {}) if names else {}
        if not isinstance(sizes, dict):
            raise ReelError("has rendition_bytes that are not an object.")
        return PageEntry(
            uri=parse_uri(entry),
            bytes=integer(entry, "bytes", 1, MAX_PAGE_BYTES),
            sha256=parse_digest(entry),
            first_frame=integer(entry, "first_frame", 0, _LAST),
            frames=integer(entry, "frames", 1, _LAST),
            groups=integer(entry, "groups", 1, MAX_PAGE_GROUPS),
            rendition_bytes={name: integer(sizes, name, 1, _BIG) for name in names},
        )
    except ReelError as error:
        raise ReelError(f"pages[{index}] {error}") from error


def load_pages(
    entries: Sequence[PageEntry], first_group: int, names: tuple[str, ...], fetch: Fetch, known: Known
) -> Iterator[Page]:
    """Yield the pages in order, each checked against its manifest entry.

    Args:
        entries: Entries of the pages.
        first_group: Number of the first group.
        names: Names of the renditions.
        fetch: Function that fetches a page.
        known: Pages that need not be fetched. Contains exactly the given pages afterwards.

    Raises:
        ReelError: A page is missing or damaged. The message names it.
    """
    firsts = accumulate((entry.groups for entry in entries), initial=first_group)
    wanted = [((entry.sha256, entry.bytes, first, names), entry) for entry, first in zip(entries, firsts, strict=False)]
    pool = ThreadPoolExecutor(AT_ONCE)
    try:
        files = pool.map(lambda entry: fetch(entry.uri, entry.bytes), (e for key, e in wanted if key not in known))
        for key, entry in wanted:
            data = None if key in known else next(files)  # errors of `fetch` name the file
            try:
                if data is not None:
                    known[key] = _parse_page(data, entry, *key[2:])
                _check_page(known[key], entry, names)
            except ReelError as error:
                raise ReelError(f"{entry.uri}: {error}") from error
            yield known[key]
        for key in known.keys() - {key for key, _ in wanted}:  # a live reel may have dropped pages
            del known[key]
    finally:
        pool.shutdown(cancel_futures=True)


def _parse_page(data: bytes, entry: PageEntry, first: int, names: tuple[str, ...]) -> Page:
    if len(data) != entry.bytes or hashlib.sha256(data).hexdigest() != entry.sha256:
        raise ReelError("is damaged: its length or its sha256 is not the manifest's. Copy the reel again.")
    document = parse_object(data)
    layers = tuple(_parse_layer(item, i, 2) for i, item in enumerate(items(document, "layers", 0, _MAX_FILES)))
    listed = items(document, "groups", entry.groups, entry.groups)
    groups = tuple(_parse_group(item, i, first + i, names) for i, item in enumerate(listed))
    if sum(layer.points for layer in layers) > most_points(sum(layer.bytes for layer in layers)):
        raise ReelError("has layers of more points than their bytes hold.")
    return Page(layers, groups)


def _check_page(page: Page, entry: PageEntry, names: tuple[str, ...]) -> None:
    first = page.groups[0].first_frame
    said = entry.groups, entry.first_frame, entry.frames
    found = len(page.groups), first, max(group.end for group in page.groups) - first
    if found != said:
        raise ReelError(f"has (groups, first frame, frames) {found}, the manifest says {said}.")
    sizes = rendition_bytes(page.groups, names)
    if sizes != entry.rendition_bytes:
        raise ReelError(f"has renditions of {sizes} bytes, the manifest says {entry.rendition_bytes}.")


def _join_layers(parts: Sequence[Page]) -> tuple[FileEntry, ...]:
    """Return all layers of a reel in order of birth, from the lists of the manifest and its pages.

    Args:
        parts: Pages, then the part of the manifest itself.

    Raises:
        ReelError: The lists contradict each other, are not in order, or do not match the groups.
    """
    found: dict[str, FileEntry] = {}
    for part in reversed(parts):
        for layer in part.layers:
            if found.setdefault(layer.uri, layer) != layer:
                raise ReelError(f"has {layer.uri} in two lists of layers that say different things of it.")
    layers = tuple(sorted(found.values(), key=birth_order))
    place = {layer.uri: index for index, layer in enumerate(layers)}
    expected = _living(layers, parts)
    for part, count in zip(parts, expected, strict=True):
        last = part is parts[-1]
        if any(place[a.uri] >= place[b.uri] for a, b in pairwise(part.layers)):
            raise ReelError(
                "has layers that are not in order of birth, and those of one group the longest-lived first."
            )
        own = [layer for layer in part.layers if layer.until is not None or not last]
        first, end = _span(part)
        if len(own) != count or any(x.until is None or x.group >= end or x.until <= first for x in own):
            where = "the manifest itself" if last else f"the page of groups {first} to {end - 1}"
            raise ReelError(f"lists other layers in {where} than those that are retired once and live in its groups.")
    return layers


def _living(layers: Sequence[FileEntry], parts: Sequence[Page]) -> list[int]:
    """Return the number of layers with `until` that live at each part. A layer lives at consecutive parts."""
    starts = [_span(part)[0] for part in parts]
    end = _span(parts[-1])[1]
    changes = [0] * (len(parts) + 1)
    for layer in layers:
        if layer.until is None:
            continue
        first, last = max(layer.group, starts[0]), min(layer.until, end) - 1
        if first <= last:
            changes[bisect_right(starts, first) - 1] += 1
            changes[bisect_right(starts, last)] -= 1
    counts, living = [], 0
    for change in changes[:-1]:
        living += change
        counts.append(living)
    return counts


def _span(part: Page) -> tuple[int, int]:
    """Return the numbers of a part's first group and of the group after its last."""
    return (part.groups[0].group, part.groups[-1].group + 1) if part.groups else (0, 0)


FORMAT = "splatreel"
_VERSIONS = 1, 2
"""Supported versions. A reel needs version 2 if it has pages, retired layers, several layers at a group, or dropped groups."""
MANIFEST = "manifest.json"
MAX_BYTES = 16 << 20
"""Maximum size of a manifest."""

_MAX_RENDITIONS = 16
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")


@dataclass(frozen=True, kw_only=True)
class Manifest(ReelHeader):
    """Content of `manifest.json`: the header and the lists of files.

    Attributes:
        generator: Program that wrote the reel.
        live: True while the reel is still being written.
        frames: End of all groups so far.
        layers: All layers, including those listed in pages.
        groups: All groups, including those listed in pages.
        first_group: Number of the first group; greater than 0 after earlier groups were dropped.
        pages: Files that list the first groups. The manifest itself lists the other groups.
        renditions: Names of the renditions, best first. The groups' own files are those of the best. Layers are common
            to all. Empty for a single rendition.
        presentation: Texts, images, sound and view limits.
    """

    generator: str
    live: bool
    frames: int
    layers: tuple[FileEntry, ...] = ()
    groups: tuple[FileEntry, ...] = ()
    first_group: int = 0
    pages: tuple[PageEntry, ...] = ()
    renditions: tuple[str, ...] = ()
    presentation: Presentation = EMPTY

    @property
    def version(self) -> int:
        """Lowest format version that supports the content."""
        many = any(a.group == b.group for a, b in pairwise(self.layers))
        retired = any(layer.until is not None for layer in self.layers)
        return 2 if self.first_group or self.pages or many or retired else 1

    @property
    def files(self) -> list[FileEntry]:
        """All files that hold points."""
        others = (entry for group in self.groups for entry in group.renditions.values())
        return [*self.layers, *self.groups, *others]

    @property
    def uris(self) -> set[str]:
        """URIs of all files of the reel except the manifest."""
        return {entry.uri for entry in (*self.files, *self.assets, *self.pages)}

    @property
    def end_group(self) -> int:
        """Number of the next group to be added."""
        return self.first_group + len(self.groups)

    @property
    def first_frame(self) -> int:
        """First frame that can be shown; 0 without groups."""
        return self.groups[0].first_frame if self.groups else 0

    @property
    def paged(self) -> int:
        """Number of groups listed in pages."""
        return sum(page.groups for page in self.pages)

    @property
    def assets(self) -> list[Asset]:
        """Images and sound files."""
        return self.presentation.assets

    def select_rendition(self, name: str) -> Manifest:
        """Return the manifest of one rendition alone. Raise `ReelError` if the reel does not have it."""
        if name not in self.renditions:
            there = f"has {', '.join(self.renditions)}" if self.renditions else "has no renditions to choose from"
            raise ReelError(f"has no rendition {name!r:.100}; it {there}.")
        groups = (replace(group.renditions.get(name, group), renditions={}) for group in self.groups)
        return replace(self, groups=tuple(groups), renditions=(), pages=())

    def without_pages(self) -> Manifest:
        """Return the same reel with all entries in the manifest itself."""
        return replace(self, pages=())

    def rendition_bytes(self) -> dict[str, int]:
        """Return the bytes of the groups by rendition."""
        return rendition_bytes(self.groups, self.renditions)

    def with_files(self, layers: Iterable[FileEntry], groups: Iterable[FileEntry]) -> Manifest:
        """Return the manifest with other files and the number of frames updated."""
        layers, groups = tuple(layers), tuple(groups)
        return replace(self, layers=layers, groups=groups, frames=max((group.end for group in groups), default=0))

    def group_entry(self, group: int) -> FileEntry:
        """Return the entry of a group by its number. Raise `ReelError` if it is not in the reel."""
        if not self.first_group <= group < self.end_group:
            there = f"{len(self.groups)} groups" + (f" from {self.first_group} on" if self.first_group else "")
            raise ReelError(f"has {there}, group {group} was asked for.")
        return self.groups[group - self.first_group]

    def living_layers(self, group: int) -> list[int]:
        """Return the indices of the layers that live at a group. The group's `alive` flags cover their points."""
        born, until, _ = self._lives
        return np.flatnonzero((born <= group) & (group < until)).tolist()

    def static_points(self, group: int) -> int:
        """Return the number of points in the layers that live at a group."""
        born, until, points = self._lives
        return int(points[(born <= group) & (group < until)].sum())

    @cached_property
    def _lives(self) -> np.ndarray:
        """Birth group, retirement group and number of points of each layer, [3, L]."""
        lives = [(layer.group, _BIG + 1 if layer.until is None else layer.until, layer.points) for layer in self.layers]
        return np.array(lives, np.int64).reshape(-1, 3).T

    def to_json(self) -> str:
        """Return the text of the file, without the entries in pages."""
        document = {
            "format": FORMAT,
            "version": self.version,
            "generator": self.generator,
            "live": self.live,
            "fps": self.fps,
            "frames": self.frames,
            "group_length": self.group_length,
            "overlap": self.overlap,
            "sh_degree": self.sh_degree,
            "bounds": [_short(corner) for corner in self.bounds],
            "up": _short(self.up),
            "camera": self.camera.to_dict(),
            "cameras": [camera.to_dict() for camera in self.cameras],
            "near": self.near,
            "antialias": self.antialias,
        }
        if self.background != BLACK:
            document["background"] = list(self.background)
        if self.transparent:
            document["transparent"] = True
        if self.origin.any():
            document["origin"] = self.origin.tolist()
        if self.source is not None:
            document["source"] = self.source.to_dict()
        if self.clearance.share:
            document["clearance"] = {"focus": _short(np.array(self.clearance.focus)), "share": self.clearance.share}
        if self.renditions:
            document["renditions"] = [{"name": n, "bytes": b} for n, b in self.rendition_bytes().items()]
        document |= self.presentation.to_json()
        if self.first_group:
            document["first_group"] = self.first_group
        if self.pages:
            document["pages"] = [page.to_json() for page in self.pages]
        own = self.groups[self.paged :]
        layers = [layer for layer in self.layers if not self.pages or layer.until is None or layer.until > own[0].group]
        document |= {"layers": [*map(_layer_to_json, layers)], "groups": [*map(_group_to_json, own)]}
        return in_lines(document)


def parse_manifest(
    data: bytes, source: str, fetch: Fetch | None = None, whole: bool = True, known: Known | None = None
) -> Manifest:
    """Parse a manifest and join it with its pages.

    Args:
        data: Content of the file.
        source: Name of the file, for messages.
        fetch: Function that fetches a page; None refuses manifests with pages.
        whole: False accepts the reel up to the first missing or damaged page.
        known: Pages parsed earlier, which are not fetched again. Updated with the pages of this manifest.

    Raises:
        ReelError: The manifest or a page is not valid.
    """
    try:
        return _parse(_load(data), fetch, whole, {} if known is None else known)
    except ReelError as error:
        raise ReelError(f"{source}: {error}") from error


def _load(data: bytes) -> dict[str, Any]:
    if len(data) > MAX_BYTES:
        raise ReelError(f"is longer than the {MAX_BYTES} bytes a manifest may have.")
    document = parse_object(data)
    if document.get("format") != FORMAT:
        raise ReelError("is not the manifest of a reel: its `format` is not 'splatreel'.")
    version = document.get("version")
    if version not in _VERSIONS or isinstance(version, bool):
        read = " and ".join(map(str, _VERSIONS))
        raise ReelError(f"has version {version!r:.60}; this Splatreel reads {read}. Update Splatreel.")
    return document


def _parse(document: dict[str, Any], fetch: Fetch | None, whole: bool, known: Known) -> Manifest:
    manifest = _parse_header(document)
    version, names = document["version"], manifest.renditions
    if version > 1:
        first = integer(document, "first_group", 0, _LAST) if "first_group" in document else 0
        manifest = replace(manifest, first_group=first, pages=_parse_page_entries(document, names))
    own = manifest.first_group + manifest.paged
    layers = tuple(_parse_layer(entry, i, version) for i, entry in enumerate(items(document, "layers", 0, _MAX_FILES)))
    listed = items(document, "groups", 0, _MAX_FILES)
    part = Page(layers, tuple(_parse_group(entry, i, own + i, names) for i, entry in enumerate(listed)))
    if not part.groups and not (manifest.live and not manifest.pages):
        raise ReelError("has no group.")
    pages, complete = _load_pages(manifest, fetch, whole, known)
    if complete:
        manifest = _joined(manifest, [*pages, part])
        _check(manifest, document)
        return manifest
    cut = manifest.first_group + sum(len(page.groups) for page in pages)
    kept = replace(manifest, pages=manifest.pages[: len(pages)], live=True)
    mortal = {layer.uri: layer for page in pages for layer in page.layers if layer.group < cut}
    stay = [layer for layer in layers if layer.until is None and layer.group < cut]
    return kept.with_files(
        sorted([*stay, *mortal.values()], key=birth_order), [g for page in pages for g in page.groups]
    )


def _load_pages(manifest: Manifest, fetch: Fetch | None, whole: bool, known: Known) -> tuple[list[Page], bool]:
    """Return the pages and whether they are complete. They can be incomplete only if `whole` is False."""
    pages: list[Page] = []
    if manifest.pages and fetch is None:
        raise ReelError("has pages, and is not read alone. Name the folder of the reel, or its address.")
    try:
        if manifest.pages and fetch:
            for page in load_pages(manifest.pages, manifest.first_group, manifest.renditions, fetch, known):
                pages.append(page)  # pages before a failing one are kept
    except ReelError:
        if whole:
            raise
    return pages, len(pages) == len(manifest.pages)


def _joined(manifest: Manifest, parts: list[Page]) -> Manifest:
    """Return the manifest with the layers and groups of all parts. The part of the manifest itself comes last."""
    return manifest.with_files(_join_layers(parts), (group for part in parts for group in part.groups))


def _check(manifest: Manifest, document: dict[str, Any]) -> None:
    layers, groups = manifest.layers, manifest.groups
    if any(a.first_frame >= b.first_frame for a, b in pairwise(groups)):
        raise ReelError("has groups that are not in order of time.")
    if document["version"] == 1 and any(a.group >= b.group for a, b in pairwise(layers)):
        raise ReelError("has layers that are not in order of time.")
    if sum(layer.points for layer in layers) > most_points(sum(layer.bytes for layer in layers)):
        raise ReelError("has layers of more points than their bytes hold.")
    for before, after in pairwise(groups):
        if before.end < after.first_frame:
            raise ReelError(f"has no group for the frames from {before.uri}'s last to {after.uri}'s first.")
    if document.get("frames") != manifest.frames or isinstance(document["frames"], bool):
        raise ReelError(f"says it has {document.get('frames')!r:.60} frames, its groups hold {manifest.frames}.")
    if layers and layers[-1].group >= manifest.end_group:
        raise ReelError(f"has a layer of group {layers[-1].group}, but {len(groups)} groups.")
    for entry, (name, size) in zip(document.get("renditions", []), manifest.rendition_bytes().items(), strict=False):
        if integer(entry, "bytes", 0, _BIG) != size:
            raise ReelError(f"says that rendition {name} has {entry['bytes']} bytes; its groups have {size}.")


def _parse_header(document: dict[str, Any]) -> Manifest:
    """Parse everything except layers, groups and pages."""
    live = boolean(document, "live")
    bounds = [numbers({"bounds": corner}, "bounds", 3) for corner in items(document, "bounds", 2, 2)]
    if (bounds[0] > bounds[1]).any():
        raise ReelError(f"has bounds whose first corner {bounds[0].tolist()} is above its second.")
    generator = document.get("generator", "")
    return Manifest(
        generator=generator if isinstance(generator, str) else "",
        live=live,
        fps=number(document, "fps", 1e-3, 1e5),
        frames=integer(document, "frames", 0 if live else 1, _BIG),
        group_length=integer(document, "group_length", 1, _BIG),
        overlap=integer(document, "overlap", 0, _BIG),
        sh_degree=integer(document, "sh_degree", 0, 3),
        bounds=np.stack(bounds),
        up=numbers(document, "up", 3),
        camera=_parse_camera(document.get("camera")),
        cameras=tuple(_parse_camera(camera) for camera in items(document, "cameras", 0, 100_000)),
        near=number(document, "near", 1e-30, 1e30) if "near" in document else 0.01,
        clearance=_parse_clearance(document["clearance"]) if "clearance" in document else NONE,
        antialias=boolean(document, "antialias", False),
        background=_parse_background(document),
        transparent=boolean(document, "transparent", False),
        origin=numbers(document, "origin", 3) if "origin" in document else np.zeros(3),
        source=parse_reel_source(document.get("source")),
        renditions=_parse_names(document),
        presentation=parse_presentation(document),
    )


def _parse_background(document: dict[str, Any]) -> tuple[float, float, float]:
    if "background" not in document:
        return BLACK
    red, green, blue = numbers(document, "background", 3).tolist()
    if not all(0 <= value <= 1 for value in (red, green, blue)):
        raise ReelError(f"has the background {[red, green, blue]}, expected 0 to 1.")
    return red, green, blue


def _parse_clearance(entry: object) -> Clearance:
    if not isinstance(entry, dict):
        raise ReelError("has a clearance that is not an object.")
    x, y, z = numbers(entry, "focus", 3).tolist()
    return Clearance((x, y, z), number(entry, "share", 0, 1))


def _parse_names(document: dict[str, Any]) -> tuple[str, ...]:
    """Parse the names of the renditions. A single rendition counts as none."""
    entries = items(document, "renditions", 0, _MAX_RENDITIONS) if "renditions" in document else []
    given = [entry.get("name") if isinstance(entry, dict) else None for entry in entries]
    names = tuple(name for name in given if isinstance(name, str) and _NAME.fullmatch(name))
    if len(set(names)) < len(given):
        raise ReelError("has renditions without names of their own, of a to z, 0 to 9, _ and -.")
    return names if len(names) > 1 else ()


def _parse_camera(value: object) -> Camera:
    if not isinstance(value, dict):
        raise ReelError("has a camera that is not an object.")
    name = value.get("name", "")
    if not isinstance(name, str) or len(name) > 200:
        raise ReelError(f"has a camera of the name {name!r:.100}.")
    try:
        viewmat, K = numbers(value, "viewmat", 16).reshape(4, 4), numbers(value, "K", 9).reshape(3, 3)
        if K[0, 0] <= 0 or K[1, 1] <= 0:
            raise ReelError(f"has the focal lengths {K[0, 0]:g} and {K[1, 1]:g} in its K, expected pixels.")
        if not 0.5 < np.linalg.det(viewmat[:3, :3]) < 2:
            raise ReelError("has a viewmat that is not a rotation and translation.")
        return Camera(
            name=name,
            viewmat=viewmat,
            K=K,
            width=integer(value, "width", 1, 1 << 20),
            height=integer(value, "height", 1, 1 << 20),
        )
    except ReelError as error:
        raise ReelError(f"camera {name!r} {error}") from error


def _short(array: np.ndarray) -> list[float]:
    """Return float32 values with the fewest digits that preserve them. Cameras take much of a small reel."""
    return [float(str(value)) for value in np.asarray(array, np.float32).ravel()]


def edit_reel(folder: Path, words: Mapping[str, str]) -> Manifest:
    """Replace texts in the manifest atomically and return the new manifest.

    `words`: New `title`, `author`, `description` or `licence`; an empty text removes the entry.

    Raises:
        ReelError: The folder holds no finished reel, or a text is too long.
    """
    file = folder / "manifest.json"
    data = read_file(file, MAX_BYTES, lambda problem: ReelError(f"{problem} Name the folder of a reel."))
    manifest = parse_manifest(data, str(file), Address(folder, ReelError).fetch)
    if manifest.live:
        raise ReelError(
            f"{file}: is still being written. Pass --title and similar options to the command that writes it."
        )
    try:
        words = {name: check_text(name, text) for name, text in words.items()}
    except ReelError as error:
        raise ReelError(f"{file}: {error}") from error
    edited = replace(manifest, presentation=replace(manifest.presentation, **words))
    sweep(folder, file.name)  # what a killed edit left
    write_bytes(file, edited.to_json().encode())
    return edited
