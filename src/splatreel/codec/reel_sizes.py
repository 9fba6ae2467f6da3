"""Sizes of a reel by file kind, section, group and point."""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from splatreel.base.errors import ReelError
from splatreel.codec.container import unpack_file
from splatreel.codec.file_entry import FileEntry
from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader

MOTION = ("offsets", "dx", "dq", "shade")
"""Sections of a group file that hold the motion of its points and the change of their colors."""
SWITCHES = ("alive", "light")
"""Sections of a group file about static points and light."""


@dataclass(frozen=True)
class ReelInfo:
    """Sizes in bytes, of one rendition if there are several.

    `bytes` includes the manifest and all pages. `first_view_bytes` includes the manifest and the first page.
    """

    manifest: Manifest
    bytes: int
    total_bytes: int
    """`bytes` with poster, thumbnails and sound: what a viewer downloads who watches the reel once to its end."""
    stored_bytes: int
    """Bytes of all files of the reel, which holds all renditions."""
    first_view_bytes: int
    """Bytes of the points that the first complete image needs: manifest, first group and the layers that live at it."""
    start_bytes: int
    """`first_view_bytes` with the poster: what a viewer downloads before the first complete image, besides the player."""
    bytes_per_second: float
    """`total_bytes` per second of video."""
    playing_bytes_per_second: float
    """Bytes per second of groups, of layers after the first ones, and of sound: what the network must deliver during playback."""
    layer_bytes: list[int]
    group_bytes: list[int]
    section_bytes: dict[str, dict[str, int]]
    """Bytes of each section over all files, for `layer` and `group`. `header` is the rest of the files."""
    bytes_per_static_point: float
    bytes_per_dynamic_point: float
    """Bytes of group files per dynamic point, including offsets over all frames."""
    float32_bytes: int
    """Bytes of the same arrays uncompressed, at 4 bytes per number."""
    rendition_bytes: dict[str, int]
    """Bytes of the groups by rendition, best first. Empty for a single rendition."""

    @property
    def bytes_by_kind(self) -> dict[str, int]:
        """Bytes of the reel by what they hold. The sum is `bytes`."""
        layer, group = self.section_bytes["layer"], self.section_bytes["group"]
        headers = layer.get("header", 0) + group.get("header", 0)
        motion = sum(group.get(name, 0) for name in MOTION)
        switches = sum(group.get(name, 0) for name in SWITCHES)
        static = sum(layer.values()) - layer.get("header", 0)
        dynamic = sum(group.values()) - group.get("header", 0) - motion - switches
        return {
            "static points": static,
            "dynamic points": dynamic,
            "motion": motion,
            "visibility and light": switches,
            "headers": headers,
            "manifest": self.bytes - sum(layer.values()) - sum(group.values()),
        }


def reel_info(location: str | Path, rendition: str | None = None) -> ReelInfo:
    """Return the sizes of a reel. All files are read, none is decoded.

    Args:
        location: Folder or URL of the reel.
        rendition: Name of a rendition; None chooses the best.

    Raises:
        ReelError: A file is missing or damaged.
    """
    whole = ReelReader(location).manifest
    reel = ReelReader(location, rendition)
    manifest = reel.manifest
    layers, groups = manifest.layers, manifest.groups
    manifest_bytes = len(whole.to_json().encode())
    layer_bytes, group_bytes = [e.bytes for e in layers], [e.bytes for e in groups]
    first = manifest_bytes + sum(page.bytes for page in whole.pages[:1])
    first += sum(layers[index].bytes for index in manifest.living_layers(manifest.first_group)) + sum(group_bytes[:1])
    seconds = (manifest.frames - manifest.first_frame) / manifest.fps
    presentation = manifest.presentation
    sound = sum(asset.bytes for asset in presentation.sound.assets) if presentation.sound else 0
    growth = sum(e.bytes for e in layers if e.group > manifest.first_group) + sum(group_bytes) + sound
    size = manifest_bytes + sum(page.bytes for page in whole.pages) + sum(layer_bytes) + sum(group_bytes)
    assets = sum(asset.bytes for asset in manifest.assets)
    return ReelInfo(
        manifest=manifest,
        bytes=size,
        total_bytes=size + assets,
        stored_bytes=size + assets + sum(file.bytes for file in whole.files) - sum(layer_bytes) - sum(group_bytes),
        first_view_bytes=first,
        start_bytes=first + (presentation.poster.asset.bytes if presentation.poster else 0),
        bytes_per_second=(size + assets) / seconds if reel.frames else 0.0,
        playing_bytes_per_second=growth / seconds if reel.frames else 0.0,
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
            _, sections = unpack_file(reel.read_file(entry), most=sys.maxsize)  # no limit, since nothing is decoded
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
