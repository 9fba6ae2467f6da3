"""Names of published files. Each name contains a digest of the content, so that its content never changes."""

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
    """Convert `groups/0003.safetensors` to `groups/0003-0123456789abcdef.safetensors`. A converted name stays the same."""
    path = PurePosixPath(uri)
    end = f"-{sha256[:_DIGITS]}"
    return uri if path.stem.endswith(end) else str(path.with_name(f"{path.stem}{end}{path.suffix}"))


def is_published_name(name: str) -> bool:
    """Return whether a name can only belong to a published reel. Other files are never deleted."""
    return _OURS.fullmatch(name) is not None


def headers_of(name: str) -> Headers:
    """Return the HTTP headers of a file. Names with a digest may be cached forever; the manifest must be revalidated."""
    kind = _TYPES.get(PurePosixPath(name).suffix, "application/octet-stream")
    return Headers(kind, _CHANGING if name in (MANIFEST, RECORD) else _LASTING)


def file_entries(value: Any) -> Iterator[dict[str, Any]]:
    """Yield every JSON object of a manifest or page that names a file by `uri`, `bytes` and `sha256`."""
    if isinstance(value, Mapping):
        if isinstance(value, dict) and all(name in value for name in ("uri", "bytes", "sha256")):
            yield value
        for part in value.values():
            yield from file_entries(part)
    elif isinstance(value, list):
        for part in value:
            yield from file_entries(part)
