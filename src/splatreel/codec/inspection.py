"""Inspection of finished reels: sizes by file kind, section, group and point, and verification, which reads and decodes all files."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.base.errors import GaussiansError, ReelError
from splatreel.codec.container import unpack_file
from splatreel.codec.manifest import FileEntry, Manifest
from splatreel.codec.mp4 import RATE
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


MOTION = ("offsets", "dx", "dq", "shade")
"""Sections of a group file that hold the motion of its points and the change of their colors."""
_SWITCHES = ("alive", "light")
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
        switches = sum(group.get(name, 0) for name in _SWITCHES)
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
