"""What files of a reel are called where they are published: each by its content, so that a name never means two things."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any

from splatreel.storage.folder import Headers

MANIFEST = "manifest.json"
RECORD = "publication.json"
_TYPES = {".json": "application/json", ".mp4": "audio/mp4", ".m4s": "audio/mp4", ".jpg": "image/jpeg"}
_CHANGING, _LASTING = "no-cache", "public, max-age=31536000, immutable"
_DIGITS = 16
_OURS = re.compile(
    r"(?:(?:layers|groups)/[\w.-]+-[0-9a-f]{16}\.safetensors|sound/[\w.-]+-[0-9a-f]{16}\.(?:mp4|m4s)"
    r"|pages/[\w.-]+-[0-9a-f]{16}\.json|thumbnails/[\w.-]+-[0-9a-f]{16}\.jpg|poster-[0-9a-f]{16}\.jpg)",
    re.ASCII,
)


def published_name(uri: str, sha256: str) -> str:
    """`groups/0003.safetensors` as `groups/0003-0123456789abcdef.safetensors`; what is called so already keeps its name."""
    path = PurePosixPath(uri)
    end = f"-{sha256[:_DIGITS]}"
    return uri if path.stem.endswith(end) else str(path.with_name(f"{path.stem}{end}{path.suffix}"))


def is_published_name(name: str) -> bool:
    """Whether a file that lies there can only be one of a published reel: others are never deleted."""
    return _OURS.fullmatch(name) is not None


def headers_of(name: str) -> Headers:
    """A name that has its digest in it may be kept for good, the manifest must be asked for again."""
    kind = _TYPES.get(PurePosixPath(name).suffix, "application/octet-stream")
    return Headers(kind, _CHANGING if name in (MANIFEST, RECORD) else _LASTING)


def file_entries(value: Any) -> Iterator[dict[str, Any]]:
    """Every object in the JSON of a manifest or a page that names a file: `uri`, `bytes` and `sha256`."""
    if isinstance(value, Mapping):
        if isinstance(value, dict) and all(name in value for name in ("uri", "bytes", "sha256")):
            yield value
        for part in value.values():
            yield from file_entries(part)
    elif isinstance(value, list):
        for part in value:
            yield from file_entries(part)
