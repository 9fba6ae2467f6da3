"""`manifest.json`: what a reel consists of (docs/format.md). Parsing trusts nothing it reads."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from splatreel.codec.budget import MOST_FRAMES, most_points
from splatreel.codec.document import parse_object
from splatreel.codec.header import BLACK, ReelHeader
from splatreel.codec.presentation import EMPTY, Asset, Presentation, parse_digest, parse_presentation, parse_uri
from splatreel.codec.quantize import boolean, integer, number, numbers
from splatreel.errors import ReelError
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import NONE, Clearance

FORMAT = "splatreel"
VERSION = 1
MAX_BYTES = 16 << 20
"""Size of the largest manifest that is read."""
MAX_FILE_BYTES = 1 << 30
"""Size of the largest layer or group file that is read."""

MAX_RENDITIONS = 16
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
_BIG = 1 << 40


@dataclass(frozen=True)
class FileEntry:
    """One layer or group file. group: the group a layer was born at, a group's own index. frames: 0 for layers.

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


@dataclass(frozen=True, kw_only=True)
class Manifest(ReelHeader):
    """The fields of `manifest.json`: the header, and the files that there are.

    live: more will come. frames: of all groups so far.
    renditions: names of the rates that the groups are there in, best first; the first is that of the groups' own files, and the
    layers are common to all. Empty where there is nothing to choose.
    """

    generator: str
    live: bool
    frames: int
    layers: tuple[FileEntry, ...] = ()
    groups: tuple[FileEntry, ...] = ()
    renditions: tuple[str, ...] = ()
    presentation: Presentation = EMPTY

    @property
    def files(self) -> list[FileEntry]:
        """Every file that holds points."""
        others = (entry for group in self.groups for entry in group.renditions.values())
        return [*self.layers, *self.groups, *others]

    @property
    def assets(self) -> list[Asset]:
        """Every other file of the reel but the manifest."""
        return self.presentation.assets

    def of_rendition(self, name: str) -> Manifest:
        """What the manifest would be with this rendition alone. Raises `ReelError` for one that the reel has not."""
        if name not in self.renditions:
            there = f"has {', '.join(self.renditions)}" if self.renditions else "has no renditions to choose from"
            raise ReelError(f"has no rendition {name!r:.100}; it {there}.")
        groups = (replace(group.renditions.get(name, group), renditions={}) for group in self.groups)
        return replace(self, groups=tuple(groups), renditions=())

    def rendition_bytes(self) -> dict[str, int]:
        """By rendition: bytes of its groups."""
        return {name: sum(g.renditions.get(name, g).bytes for g in self.groups) for name in self.renditions}

    def with_files(self, layers: list[FileEntry], groups: list[FileEntry]) -> Manifest:
        """The same reel with these files, its number of frames counted anew."""
        frames = max((g.first_frame + g.frames for g in groups), default=0)
        return replace(self, layers=tuple(layers), groups=tuple(groups), frames=frames)

    def static_points(self, group: int) -> int:
        """Static points of all layers born up to a group."""
        return sum(layer.points for layer in self.layers if layer.group <= group)

    def to_json(self) -> str:
        """The text of the file."""
        document = {
            "format": FORMAT,
            "version": VERSION,
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
        if self.clearance.share:
            document["clearance"] = {"focus": _short(np.array(self.clearance.focus)), "share": self.clearance.share}
        if self.renditions:
            document["renditions"] = [{"name": n, "bytes": b} for n, b in self.rendition_bytes().items()]
        document |= self.presentation.to_json()
        document |= {
            "layers": [_file_to_json(layer, "layer") for layer in self.layers],
            "groups": [_file_to_json(group, "group") for group in self.groups],
        }
        return "{\n" + ",\n".join(f"{json.dumps(name)}: {_lines(value)}" for name, value in document.items()) + "\n}\n"


def parse_manifest(data: bytes, source: str) -> Manifest:
    """The manifest in data. Raises `ReelError`, with `source` in its message, for whatever is not a valid one."""
    try:
        return _parse(_load(data))
    except ReelError as error:
        raise ReelError(f"{source}: {error}") from error


def _load(data: bytes) -> dict[str, Any]:
    if len(data) > MAX_BYTES:
        raise ReelError(f"is longer than the {MAX_BYTES} bytes a manifest may have.")
    document = parse_object(data)
    if document.get("format") != FORMAT:
        raise ReelError("is not the manifest of a reel: its `format` is not 'splatreel'.")
    if document.get("version") != VERSION or isinstance(document["version"], bool):
        raise ReelError(f"has version {document.get('version')!r}; this Splatreel reads {VERSION}. Update Splatreel.")
    return document


def _parse(document: dict[str, Any]) -> Manifest:
    live = boolean(document, "live")
    bounds = [numbers({"bounds": corner}, "bounds", 3) for corner in _list(document, "bounds", 2, 2)]
    if (bounds[0] > bounds[1]).any():
        raise ReelError(f"has bounds whose first corner {bounds[0].tolist()} is above its second.")
    layers = [_parse_file(entry, "layer", i) for i, entry in enumerate(_list(document, "layers", 0, 1 << 20))]
    names = _parse_names(document)
    groups = [_parse_group(entry, i, names) for i, entry in enumerate(_list(document, "groups", 0, 1 << 20))]
    for kind, order in (("groups", [g.first_frame for g in groups]), ("layers", [layer.group for layer in layers])):
        if any(a >= b for a, b in pairwise(order)):
            raise ReelError(f"has {kind} that are not in order of time.")
    if not groups and not live:
        raise ReelError("has no group.")
    if sum(layer.points for layer in layers) > most_points(sum(layer.bytes for layer in layers)):
        raise ReelError("has layers of more points than their bytes hold.")
    for before, after in pairwise(groups):
        if before.first_frame + before.frames < after.first_frame:
            raise ReelError(f"has no group for the frames from {before.uri}'s last to {after.uri}'s first.")
    end = max((group.first_frame + group.frames for group in groups), default=0)
    if document.get("frames") != end:
        raise ReelError(f"says it has {document.get('frames')!r:.60} frames, its groups hold {end}.")
    if layers and layers[-1].group >= len(groups):
        raise ReelError(f"has a layer of group {layers[-1].group}, but {len(groups)} groups.")
    generator = document.get("generator", "")
    manifest = Manifest(
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
        cameras=tuple(_parse_camera(camera) for camera in _list(document, "cameras", 0, 100_000)),
        near=number(document, "near", 1e-30, 1e30) if "near" in document else 0.01,
        clearance=_parse_clearance(document["clearance"]) if "clearance" in document else NONE,
        antialias=boolean(document, "antialias", False),
        background=_parse_background(document),
        layers=tuple(layers),
        groups=tuple(groups),
        renditions=names,
        presentation=parse_presentation(document),
    )
    for entry, (name, size) in zip(document.get("renditions", []), manifest.rendition_bytes().items(), strict=False):
        if integer(entry, "bytes", 0, _BIG) != size:
            raise ReelError(f"says that rendition {name} has {entry['bytes']} bytes; its groups have {size}.")
    return manifest


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
    """Of the renditions. One alone is none to choose from."""
    entries = _list(document, "renditions", 0, MAX_RENDITIONS) if "renditions" in document else []
    given = [entry.get("name") if isinstance(entry, dict) else None for entry in entries]
    names = tuple(name for name in given if isinstance(name, str) and _NAME.fullmatch(name))
    if len(set(names)) < len(given):
        raise ReelError("has renditions without names of their own, of a to z, 0 to 9, _ and -.")
    return names if len(names) > 1 else ()


def _parse_group(entry: object, index: int, names: tuple[str, ...]) -> FileEntry:
    """A group in all its renditions; `entry` itself is the first."""
    group = _parse_file(entry, "group", index)
    others = entry.get("renditions", {}) if isinstance(entry, dict) else {}
    if not isinstance(others, dict) or not all(isinstance(others.get(name), dict) for name in names[1:]):
        raise ReelError(f"groups[{index}] is not there in each of the renditions {', '.join(names)}.")
    common = {"first_frame": group.first_frame, "frames": group.frames}
    return replace(group, renditions={name: _parse_file(others[name] | common, "group", index) for name in names[1:]})


def _parse_file(entry: object, kind: str, index: int) -> FileEntry:
    try:
        if not isinstance(entry, dict):
            raise ReelError("is not an object.")
        size = integer(entry, "bytes", 1, MAX_FILE_BYTES)
        return FileEntry(
            uri=parse_uri(entry),
            bytes=size,
            sha256=parse_digest(entry),
            first_frame=integer(entry, "first_frame", 0, _BIG),
            frames=integer(entry, "frames", 1, MOST_FRAMES) if kind == "group" else 0,
            points=integer(entry, "points", 0, most_points(size)),
            group=index if kind == "group" else integer(entry, "group", 0, _BIG),
        )
    except ReelError as error:
        raise ReelError(f"{kind}s[{index}] {error}") from error


def _file_to_json(entry: FileEntry, kind: str) -> dict[str, Any]:
    common = {"uri": entry.uri, "bytes": entry.bytes, "sha256": entry.sha256, "first_frame": entry.first_frame}
    own = {"frames": entry.frames} if kind == "group" else {"group": entry.group}
    others = {
        name: {"uri": file.uri, "bytes": file.bytes, "sha256": file.sha256, "points": file.points}
        for name, file in entry.renditions.items()
    }
    return common | own | {"points": entry.points} | ({"renditions": others} if others else {})


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
            raise ReelError("has a viewmat that is no rotation and translation.")
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
    """As float32, in as few digits as tell them apart: many cameras are a good part of a small reel."""
    return [float(str(value)) for value in np.asarray(array, np.float32).ravel()]


def _lines(value: Any) -> str:
    """JSON on one line, or, of a list of objects, on one each: short, and yet to be read."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "[\n" + ",\n".join(_lines(entry) for entry in value) + "\n]"
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _list(document: dict[str, Any], name: str, low: int, high: int) -> list:
    value = document.get(name)
    if not isinstance(value, list) or not low <= len(value) <= high:
        raise ReelError(f"has {name} that are not a list of {low} to {high} items.")
    return value
