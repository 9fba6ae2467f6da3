"""Layer and group files: safetensors files whose tensors are sections and whose metadata describes their coding."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import safetensors.numpy

from splatreel.base.errors import ReelError
from splatreel.codec import quantize
from splatreel.codec.document import parse_object
from splatreel.codec.quantize import Parameters, integer, is_whole

MAX_POINTS = 1 << 23
"""Maximum number of points in one file."""


@dataclass(frozen=True)
class Section:
    """Bytes of a section, and the parameters from the header that describe its coding."""

    data: bytes
    parameters: Parameters


Sections = dict[str, Section]


def required(sections: Sections, name: str) -> Section:
    """Return the section of a given name. Raise `ReelError` if it is missing."""
    if name not in sections:
        raise ReelError(f"has no section {name!r}.")
    return sections[name]


def section_of(sections: Sections, name: str, codec: str) -> Section:
    """Return the section of a given name and codec. Raise `ReelError` if it is missing or has another codec."""
    section = required(sections, name)
    found = section.parameters.get("codec")
    if found != codec:
        raise ReelError(f"section {name!r} has the unknown codec {found!r:.60}, expected {codec!r}.")
    return section


def named(name, function, *arguments):
    """Call a function and prefix its `ReelError` with the section's name."""
    try:
        return function(*arguments)
    except ReelError as error:
        raise ReelError(f"section {name!r} {error}") from error


VERSION = 1
"""Version of layer and group files. Manifests have their own version."""
_KEY = "splatreel"
_PADDING = "padding"
_MAX_HEADER = 1 << 20


@dataclass(frozen=True)
class FileHeader:
    """Description of a file in its own metadata.

    Attributes:
        kind: `layer` or `group`.
        frames: Frames of the group; 0 for a layer.
    """

    kind: str
    index: int
    points: int
    first_frame: int
    frames: int = 0


def pack_file(header: FileHeader, sections: Sections) -> bytes:
    """Return the bytes of a file. The same content gives the same bytes.

    A short file with many points is padded with zeros to the length that readers require.
    """
    own: dict[str, Any] = {"version": VERSION, "kind": header.kind, "index": header.index, "points": header.points}
    own |= {"first_frame": header.first_frame} | ({"frames": header.frames} if header.kind == "group" else {})
    own["sections"] = {name: section.parameters for name, section in sorted(sections.items())}
    tensors = {name: np.frombuffer(section.data, np.uint8) for name, section in sections.items()}
    metadata = {_KEY: json.dumps(own, separators=(",", ":"), allow_nan=False)}
    data = safetensors.numpy.save(tensors, metadata)
    if short := quantize.missing_bytes(header.points, header.frames, sections, len(data)):
        data = safetensors.numpy.save(tensors | {_PADDING: np.zeros(short, np.uint8)}, metadata)
    return data


def unpack_file(data: bytes, most: int | None = None) -> tuple[FileHeader, Sections]:
    """Return the header and sections of a file.

    `most`: Memory in bytes that decoding may take; None uses `quantize.allowed_memory`.

    Raises:
        ReelError: The data is not such a file.
    """
    size = int.from_bytes(data[:8], "little")
    if len(data) < 8 or size > min(_MAX_HEADER, len(data) - 8):
        raise ReelError("is not a safetensors file, or truncated.")
    tensors = parse_object(data[8 : 8 + size], "header")
    metadata = tensors.pop("__metadata__", None)
    text = metadata.get(_KEY) if isinstance(metadata, dict) else None
    if not isinstance(text, str):
        raise ReelError("has no `splatreel` metadata: it is not part of a reel.")
    own = parse_object(text, "metadata")
    if own.get("version") != VERSION or isinstance(own["version"], bool):
        raise ReelError(f"has version {own.get('version')!r}; this Splatreel reads {VERSION}. Update Splatreel.")
    if own.get("kind") not in ("layer", "group"):
        raise ReelError(f"is of the unknown kind {own.get('kind')!r:.100}.")
    parameters = own.get("sections")
    if not isinstance(parameters, dict) or not all(isinstance(p, dict) for p in parameters.values()):
        raise ReelError("has metadata without a table of sections.")
    header = FileHeader(
        kind=own["kind"],
        index=integer(own, "index", 0, 1 << 40),
        points=integer(own, "points", 0, 1 << 40),
        first_frame=integer(own, "first_frame", 0, 1 << 40),
        frames=integer(own, "frames", 1, 1 << 40) if own["kind"] == "group" else 0,
    )
    body = memoryview(data)[8 + size :]
    sections = {name: Section(_tensor(body, tensors, name), p) for name, p in parameters.items()}
    quantize.check_memory(header.points, header.frames, sections, len(data), most)
    return header, sections


def _tensor(body: memoryview, tensors: dict[str, Any], name: str) -> bytes:
    tensor = tensors.get(name)
    if not isinstance(tensor, dict) or tensor.get("dtype") != "U8":
        raise ReelError(f"section {name!r} is in the metadata, but no tensor of bytes.")
    offsets = tensor.get("data_offsets")
    if not isinstance(offsets, list) or len(offsets) != 2 or not all(is_whole(o) for o in offsets):
        raise ReelError(f"section {name!r} has no valid data offsets.")
    begin, end = map(int, offsets)
    if not 0 <= begin <= end <= len(body) or tensor.get("shape") != [end - begin]:
        raise ReelError(f"section {name!r} lies outside of the file, which is truncated or damaged.")
    return bytes(body[begin:end])
