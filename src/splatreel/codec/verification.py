"""Verification of a reel: all files are read, decoded and compared with the manifest and their headers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.base.errors import GaussiansError, ReelError
from splatreel.codec.fragments import RATE
from splatreel.codec.opus_sound import TYPE, check_sound_size, decode_sound
from splatreel.codec.reader import ReelReader


@dataclass(frozen=True)
class Verified:
    """Result of a successful verification."""

    files: int
    bytes: int
    layers: int
    groups: int
    points: int
    """Static and dynamic points, of the best rendition."""
    strangers: list[str]
    """Files in the reel's folder that the manifest does not name. Empty for a remote reel."""


def verify_reel(location: str | Path, most: int | None = None) -> Verified:
    """Check lengths, digests, ranges and decoding of all files in every rendition.

    Args:
        location: Folder or URL of the reel.
        most: Memory in bytes that a file may take, see `ReelReader`.

    Raises:
        ReelError: The message has one line per problem, with the file and the section.
    """
    reel = ReelReader(location, most=most)
    manifest = reel.manifest
    problems: list[str] = []
    for index in range(len(manifest.layers)):
        problems += _problems_of(lambda i=index: _check_layer(reel, i))
    for rendition in manifest.renditions or (None,):
        chosen = ReelReader(location, rendition, most)
        for group in manifest.groups:
            problems += _problems_of(lambda r=chosen, i=group.group: _check_group(r, i))
    for asset in manifest.assets:
        problems += _problems_of(lambda a=asset: reel.read_file(a))
    problems += _problems_of(lambda: _check_sound(reel))
    if problems:
        raise ReelError("\n".join(dict.fromkeys(problems)))
    return Verified(
        files=len(manifest.files) + len(manifest.assets) + len(manifest.pages) + 1,
        bytes=sum(entry.bytes for entry in [*manifest.files, *manifest.assets, *manifest.pages]),
        layers=len(manifest.layers),
        groups=len(manifest.groups),
        points=sum(entry.points for entry in (*manifest.layers, *manifest.groups)),
        strangers=_strangers(Path(location), {"manifest.json"} | manifest.uris),
    )


def _strangers(location: Path, known: set[str]) -> list[str]:
    folder = location.parent if location.name == "manifest.json" else location
    if not folder.is_dir():
        return []
    return sorted({path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()} - known)


def _problems_of(check: Callable[[], object]) -> list[str]:
    try:
        check()
    except (ReelError, GaussiansError) as error:
        return [str(error)]
    return []


def _check_layer(reel: ReelReader, index: int) -> None:
    reel.forget()
    layer, uri = reel.layer(index), reel.manifest.layers[index].uri
    layer.check_finite(uri)


def _check_group(reel: ReelReader, index: int) -> None:
    reel.forget()
    group, uri = reel.group(index), reel.manifest.group_entry(index).uri
    group.dynamic.check_finite(uri)
    if not (np.isfinite(group.dx).all() and np.isfinite(group.dq).all()):
        raise ReelError(f"{uri}: section 'offsets' decodes to NaN or infinity.")
    if group.shade is not None and not np.isfinite(group.shade).all():
        raise ReelError(f"{uri}: section 'shade' decodes to NaN or infinity.")


def _check_sound(reel: ReelReader) -> None:
    """Decode every segment alone with the initialization file, and compare its times with the manifest."""
    sound = reel.manifest.presentation.sound
    if sound is None or sound.type != TYPE:
        return
    for segment in sound.segments:
        check_sound_size(segment)
        uri, at = segment.asset.uri, segment.start
        init, data = reel.read_file(sound.init), reel.read_file(segment.asset)
        try:
            for time, part in decode_sound(init, [data], sound.channels):
                if abs(time / RATE - at) > 1e-3:
                    raise ReelError(f"has sound at {time / RATE:.3f} s, expected {at:.3f} s.")
                at += len(part) / RATE
                if at > segment.start + segment.seconds + 1e-3:
                    break
        except ReelError as error:
            raise ReelError(f"{uri}: {error}") from error
        if abs(at - segment.start - segment.seconds) > 1e-3:
            raise ReelError(f"{uri}: holds sound up to {at:.3f} s, not {segment.start + segment.seconds:.3f} s.")
