"""Pages of a manifest: files that list older groups and the retired layers that they need (docs/format.md).

With pages the manifest of an hour stays small. A live reel's manifest is refetched without the entries that no longer
change.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import accumulate, pairwise
from typing import Any

from splatreel.base.errors import ReelError
from splatreel.codec.budget import most_points
from splatreel.codec.document import in_lines, items, parse_object
from splatreel.codec.file_entry import (
    BIG,
    MAX_FILES,
    FileEntry,
    birth_order,
    group_to_json,
    layer_to_json,
    parse_group,
    parse_layer,
)
from splatreel.codec.presentation import parse_digest, parse_uri
from splatreel.codec.quantize import integer

PAGE = 64
"""Groups per page when writing."""
MAX_PAGE_GROUPS = 1024
"""Maximum groups per page when reading."""
MAX_PAGES = 1 << 14
MAX_PAGE_BYTES = 1 << 20
MAX_PAGES_BYTES = 64 << 20
"""Maximum size of all pages together."""
LAST = 1 << 31
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
        first_frame: First frame of its first group.
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
        """Return the JSON object that `parse_page_entries` accepts."""
        document = {name: value for name, value in vars(self).items() if name != "rendition_bytes"}
        return document | ({"rendition_bytes": dict(self.rendition_bytes)} if self.rendition_bytes else {})


@dataclass(frozen=True)
class Page:
    """Groups of a page, and the layers with `until` that live at any of them, in order of birth."""

    layers: tuple[FileEntry, ...]
    groups: tuple[FileEntry, ...]

    def to_bytes(self) -> bytes:
        """Return the content of the file."""
        layers, groups = map(layer_to_json, self.layers), map(group_to_json, self.groups)
        return in_lines({"layers": list(layers), "groups": list(groups)}).encode()


def make_page(
    layers: Iterable[FileEntry], groups: Sequence[FileEntry], names: Sequence[str]
) -> tuple[PageEntry, bytes]:
    """Return the manifest entry and the file of a page.

    Args:
        layers: All layers of the reel.
        groups: Groups of the page.
        names: Names of the renditions.
    """
    first, last = groups[0].group, groups[-1].group
    data = Page(tuple(retired_layers(layers, first, last)), tuple(groups)).to_bytes()
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


def retired_layers(layers: Iterable[FileEntry], first: int, last: int) -> list[FileEntry]:
    """Return the layers with `until` that live at any of the groups `first` to `last`."""
    return [layer for layer in layers if layer.until is not None and layer.group <= last and first < layer.until]


def rendition_bytes(groups: Iterable[FileEntry], names: Sequence[str]) -> dict[str, int]:
    """Return the bytes of groups by rendition."""
    sizes = dict.fromkeys(names, 0)
    for group in groups:
        for name in names:
            sizes[name] += group.renditions.get(name, group).bytes
    return sizes


def parse_page_entries(document: Mapping[str, Any], names: Sequence[str]) -> tuple[PageEntry, ...]:
    """Parse the manifest's `pages`. Raise `ReelError` if they are not valid."""
    if "pages" not in document:
        return ()
    entries = items(document, "pages", 0, MAX_PAGES)
    pages = tuple(_parse_entry(entry, index, names) for index, entry in enumerate(entries))
    if sum(page.bytes for page in pages) > MAX_PAGES_BYTES:
        raise ReelError(f"has pages of more than the {MAX_PAGES_BYTES} bytes that all of them may have.")
    if sum(page.groups for page in pages) > MAX_FILES:
        raise ReelError(f"has pages of more than {MAX_FILES} groups.")
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
            first_frame=integer(entry, "first_frame", 0, LAST),
            frames=integer(entry, "frames", 1, LAST),
            groups=integer(entry, "groups", 1, MAX_PAGE_GROUPS),
            rendition_bytes={name: integer(sizes, name, 1, BIG) for name in names},
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
    layers = tuple(parse_layer(item, i, 2) for i, item in enumerate(items(document, "layers", 0, MAX_FILES)))
    listed = items(document, "groups", entry.groups, entry.groups)
    groups = tuple(parse_group(item, i, first + i, names) for i, item in enumerate(listed))
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


def join_layers(parts: Sequence[Page]) -> tuple[FileEntry, ...]:
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
