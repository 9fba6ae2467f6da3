"""Editing of a finished reel's title, author, description and license. The points do not change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from splatreel.base.atomic import sweep, write_bytes
from splatreel.base.errors import ReelError
from splatreel.base.untrusted import read_file
from splatreel.codec.manifest import MAX_BYTES, Manifest, parse_manifest
from splatreel.codec.presentation import check_text
from splatreel.storage.address import Address


def edit_reel(folder: Path, words: Mapping[str, str]) -> Manifest:
    """Replace texts in the manifest atomically and return the new manifest.

    Args:
        folder: Folder of the reel.
        words: New `title`, `author`, `description` or `licence`; an empty text removes the entry.

    Raises:
        ReelError: The folder holds no finished reel, or a text is too long.
    """
    file = folder / "manifest.json"
    data = read_file(file, MAX_BYTES, lambda problem: ReelError(f"{problem} Name the folder of a reel."))
    manifest = parse_manifest(data, str(file), Address(folder, ReelError).fetch)
    if manifest.live:
        raise ReelError(
            f"{file}: is still being written. Pass --title and similar options to the command that writes it."
        )
    try:
        words = {name: check_text(name, text) for name, text in words.items()}
    except ReelError as error:
        raise ReelError(f"{file}: {error}") from error
    edited = replace(manifest, presentation=replace(manifest.presentation, **words))
    sweep(folder, file.name)  # what a killed edit left
    write_bytes(file, edited.to_json().encode())
    return edited
