"""What a manifest, or one of its pages, says of a layer or group file (docs/format.md). Parsing trusts nothing it reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from splatreel.codec.budget import MOST_FRAMES, most_points
from splatreel.codec.presentation import parse_digest, parse_uri
from splatreel.codec.quantize import integer
from splatreel.errors import ReelError

MAX_FILE_BYTES = 1 << 30
"""Size of the largest layer or group file that is read."""
MAX_FILES = 1 << 20
"""Layers, and groups, that are read of one reel."""
BIG = 1 << 40
"""No number of a frame or a group is larger."""


@dataclass(frozen=True)
class FileEntry:
    """One layer or group file. group: the group a layer was born at, a group's own number. frames: 0 for layers.

    until: the group at which a layer is retired, the first that does not show it; None: it never is.
    renditions: the same group in the reel's other renditions, by name; without renditions of their own.
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

    def lives_at(self, group: int) -> bool:
        """Whether a group shows this layer's points, as far as they are alive."""
        return self.group <= group and (self.until is None or group < self.until)

    @property
    def end(self) -> int:
        """The frame after a group's last."""
        return self.first_frame + self.frames


def birth_order(layer: FileEntry) -> tuple[int, int]:
    """What layers are sorted by: birth, and of one group the longest-lived first, so that a page's layers end a group's."""
    return layer.group, -BIG if layer.until is None else -layer.until


def parse_layer(entry: object, index: int, version: int) -> FileEntry:
    """layers[index]. version: of the manifest; only the second knows `until`."""
    try:
        common = _common(entry)
        born = integer(common, "group", 0, BIG)
        until = integer(common, "until", born + 1, BIG) if version > 1 and "until" in common else None
        return _file(common, 0, born, until)
    except ReelError as error:
        raise ReelError(f"layers[{index}] {error}") from error


def parse_group(entry: object, index: int, number: int, names: tuple[str, ...]) -> FileEntry:
    """groups[index], the group of that number in all its renditions; `entry` itself is the first of these names."""
    try:
        common = _common(entry)
        frames = integer(common, "frames", 1, MOST_FRAMES)
        others = common.get("renditions", {})
        if not isinstance(others, dict) or not all(isinstance(others.get(name), dict) for name in names[1:]):
            raise ReelError(f"is not there in each of the renditions {', '.join(names)}.")
        time = {"first_frame": common.get("first_frame")}
        found = {name: _file(others[name] | time, frames, number) for name in names[1:]}
        return _file(common, frames, number, None, found)
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
    """What `parse_layer` takes."""
    own = {"group": entry.group} | ({} if entry.until is None else {"until": entry.until})
    return _common_fields(entry) | own | {"points": entry.points}


def group_to_json(entry: FileEntry) -> dict[str, Any]:
    """What `parse_group` takes."""
    others = {
        name: {"uri": file.uri, "bytes": file.bytes, "sha256": file.sha256, "points": file.points}
        for name, file in entry.renditions.items()
    }
    own = {"frames": entry.frames, "points": entry.points}
    return _common_fields(entry) | own | ({"renditions": others} if others else {})


def _common_fields(entry: FileEntry) -> dict[str, Any]:
    return {"uri": entry.uri, "bytes": entry.bytes, "sha256": entry.sha256, "first_frame": entry.first_frame}
