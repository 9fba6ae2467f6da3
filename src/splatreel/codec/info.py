"""Where the bytes of a reel are: per kind of file and section, per group, per point."""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from splatreel.codec.container import unpack_file
from splatreel.codec.file_entry import FileEntry
from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.errors import ReelError


@dataclass(frozen=True)
class ReelInfo:
    """Sizes in bytes, of one rendition where there are several. The manifest counts into `bytes` and `first_view_bytes` only, its pages
    into `bytes`, the first of them into `first_view_bytes`."""

    manifest: Manifest
    bytes: int
    first_view_bytes: int
    """What a player fetches before it shows the first frame: the manifest, the first group and the layers that live at it."""
    bytes_per_second: float
    """Of everything but the first layers, which are fetched once."""
    layer_bytes: list[int]
    group_bytes: list[int]
    section_bytes: dict[str, dict[str, int]]
    """`layer` and `group`: bytes of each section over all files of that kind; `header` is the rest of the files."""
    bytes_per_static_point: float
    bytes_per_dynamic_point: float
    """Of a group file, offsets over all its frames included."""
    float32_bytes: int
    """What the same arrays take uncompressed: 4 bytes a number."""
    rendition_bytes: dict[str, int]
    """By rendition, best first: bytes of its groups. Empty where there is nothing to choose."""


def reel_info(location: str | Path, rendition: str | None = None) -> ReelInfo:
    """Sizes of a reel. Reads all files, decodes none. Raises `ReelError` if one is missing or damaged.

    rendition: which one, of those that the manifest names; None: the best.
    """
    whole = ReelReader(location).manifest
    reel = ReelReader(location, rendition)
    manifest = reel.manifest
    layers, groups = manifest.layers, manifest.groups
    manifest_bytes = len(whole.to_json().encode())
    layer_bytes, group_bytes = [e.bytes for e in layers], [e.bytes for e in groups]
    first = manifest_bytes + sum(page.bytes for page in whole.pages[:1])
    first += sum(layers[index].bytes for index in manifest.living_layers(manifest.first_group)) + sum(group_bytes[:1])
    growth = sum(e.bytes for e in layers if e.group > manifest.first_group) + sum(group_bytes)
    seconds = (manifest.frames - manifest.first_frame) / manifest.fps
    return ReelInfo(
        manifest=manifest,
        bytes=manifest_bytes + sum(page.bytes for page in whole.pages) + sum(layer_bytes) + sum(group_bytes),
        first_view_bytes=first,
        bytes_per_second=growth / seconds if reel.frames else 0.0,
        layer_bytes=layer_bytes,
        group_bytes=group_bytes,
        section_bytes={"layer": _section_bytes(reel, layers), "group": _section_bytes(reel, groups)},
        bytes_per_static_point=sum(layer_bytes) / max(sum(e.points for e in layers), 1),
        bytes_per_dynamic_point=sum(group_bytes) / max(sum(e.points for e in groups), 1),
        float32_bytes=_float32_bytes(manifest),
        rendition_bytes=whole.rendition_bytes(),
    )


def _section_bytes(reel: ReelReader, entries: tuple[FileEntry, ...]) -> dict[str, int]:
    sizes: Counter[str] = Counter()
    for entry in entries:
        try:
            _, sections = unpack_file(reel.read_file(entry), most=sys.maxsize)  # nothing is decoded
        except ReelError as error:
            raise ReelError(f"{entry.uri}: {error}") from error
        for name, section in sections.items():
            sizes[name] += len(section.data)
        sizes["header"] += entry.bytes - sum(len(section.data) for section in sections.values())
    return dict(sizes.most_common())


def _float32_bytes(manifest: Manifest) -> int:
    numbers = 3 + 4 + 3 + 1 + 3 * (manifest.sh_degree + 1) ** 2
    points = sum(entry.points for entry in (*manifest.layers, *manifest.groups))
    return 4 * (numbers * points + sum(7 * entry.points * entry.frames for entry in manifest.groups))
