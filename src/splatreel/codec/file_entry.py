"""Entries of a manifest or of its pages for layer and group files (docs/format.md). The parsers accept untrusted input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from splatreel.base.errors import ReelError
from splatreel.codec.budget import MOST_FRAMES, most_points
from splatreel.codec.presentation import parse_digest, parse_uri
from splatreel.codec.quantize import integer

MAX_FILE_BYTES = 1 << 30
"""Maximum size of a layer or group file."""
MAX_FILES = 1 << 20
"""Maximum number of layers, and of groups, in a reel."""
BIG = 1 << 40
"""Upper bound of frame and group numbers."""


@dataclass(frozen=True)
class FileEntry:
    """Entry of one layer or group file.

    Attributes:
        uri: Path relative to the manifest.
        bytes: Size of the file.
        sha256: Digest of the file, hexadecimal.
        first_frame: First frame of the group.
        frames: Frames of the group; 0 for a layer.
        points: Number of points.
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
    return layer.group, -BIG if layer.until is None else -layer.until


def parse_layer(entry: object, index: int, version: int) -> FileEntry:
    """Parse layers[index] of a manifest. Only version 2 has `until`."""
    try:
        common = _common(entry)
        born = integer(common, "group", 0, BIG)
        until = integer(common, "until", born + 1, BIG) if version > 1 and "until" in common else None
        return _file(common, 0, born, until)
    except ReelError as error:
        raise ReelError(f"layers[{index}] {error}") from error


def parse_group(entry: object, index: int, number: int, names: tuple[str, ...]) -> FileEntry:
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
        overlap = integer(common, "overlap", 0, BIG) if "overlap" in common else None
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
    size = integer(entry, "bytes", 1, MAX_FILE_BYTES)
    return FileEntry(
        uri=parse_uri(entry),
        bytes=size,
        sha256=parse_digest(entry),
        first_frame=integer(entry, "first_frame", 0, BIG),
        frames=frames,
        points=integer(entry, "points", 0, most_points(size)),
        group=group,
        renditions=renditions or {},
        until=until,
    )


def layer_to_json(entry: FileEntry) -> dict[str, Any]:
    """Return the JSON object that `parse_layer` accepts."""
    own = {"group": entry.group} | ({} if entry.until is None else {"until": entry.until})
    return _common_fields(entry) | own | {"points": entry.points}


def group_to_json(entry: FileEntry) -> dict[str, Any]:
    """Return the JSON object that `parse_group` accepts."""
    others = {
        name: {"uri": file.uri, "bytes": file.bytes, "sha256": file.sha256, "points": file.points}
        for name, file in entry.renditions.items()
    }
    own = {"frames": entry.frames} | ({} if entry.overlap is None else {"overlap": entry.overlap})
    own["points"] = entry.points
    return _common_fields(entry) | own | ({"renditions": others} if others else {})


def _common_fields(entry: FileEntry) -> dict[str, Any]:
    return {"uri": entry.uri, "bytes": entry.bytes, "sha256": entry.sha256, "first_frame": entry.first_frame}
