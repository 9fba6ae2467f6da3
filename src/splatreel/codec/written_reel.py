"""State of a reel that an earlier run wrote on this machine: its manifest, damaged files and leftover files."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from splatreel.base.errors import ReelError
from splatreel.base.untrusted import open_regular
from splatreel.codec.file_entry import FileEntry
from splatreel.codec.manifest import MANIFEST, MAX_BYTES, Manifest, parse_manifest
from splatreel.codec.presentation import Asset
from splatreel.storage.address import Address

_NUMBERED = re.compile(r"(?:layers|groups|pages)/(\d+)(?:\.[A-Za-z0-9_-]+)?\.(?:safetensors|json)")


def read_written_manifest(folder: Path) -> Manifest | None:
    """Return the manifest in a folder up to its first damaged page, or None without a manifest.

    Raises:
        ReelError: The manifest is invalid or cannot be read.
    """
    file = folder / MANIFEST
    try:
        with open_regular(file, ReelError) as opened:
            data = opened.read(MAX_BYTES + 1)
        return parse_manifest(data, str(file), Address(folder, ReelError).fetch, whole=False)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ReelError(f"{file}: cannot be read ({error.strerror}). Make it readable or delete it.") from error


def first_damaged_group(folder: Path, manifest: Manifest) -> int:
    """Return the number of the first group with a damaged file or layer, or of the next group if all are intact.

    Raises:
        ReelError: A file cannot be read.
    """
    broken = [entry.group for entry in manifest.files if not is_intact(folder, entry)]
    return max(min(broken, default=manifest.end_group), manifest.first_group)


def is_intact(folder: Path, entry: FileEntry | Asset) -> bool:
    """Return whether a file has the length and digest of its entry. Raise `ReelError` if it cannot be read."""
    path, digest = folder / entry.uri, hashlib.sha256()
    try:
        if path.stat().st_size != entry.bytes:
            return False
        with open_regular(path, ReelError) as file:
            while part := file.read(1 << 20):
                digest.update(part)
    except FileNotFoundError:
        return False
    except OSError as error:
        raise ReelError(f"{path}: cannot be read ({error.strerror}). Make it readable or delete it.") from error
    return digest.hexdigest() == entry.sha256


def find_leftover_files(folder: Path, manifest: Manifest, cut: bool) -> list[str]:
    """Return files of dropped groups, and pages, that a killed writer did not delete.

    Args:
        folder: Folder of the reel.
        manifest: Manifest of the reel.
        cut: Include files after the last group.
    """
    found, named = [], manifest.uris
    for path in (path for kind in ("layers", "groups", "pages") for path in (folder / kind).glob("*")):
        uri = path.relative_to(folder).as_posix()
        name = _NUMBERED.fullmatch(uri)
        if not name or uri in named:
            continue
        number = int(name[1])
        if uri.startswith("pages/") or number < manifest.first_group or (cut and number >= manifest.end_group):
            found.append(uri)
    return sorted(found)
