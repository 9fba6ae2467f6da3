"""`splatreel info` and `splatreel verify`."""

from __future__ import annotations

import dataclasses
import json as json_format
from collections import Counter
from typing import TYPE_CHECKING

from splatreel.cli.options import ReelAddress, megabytes, reel_folder
from splatreel.cli.printing import counted, say

if TYPE_CHECKING:
    from splatreel.codec.inspection import ReelInfo
    from splatreel.codec.manifest import Manifest
    from splatreel.codec.presentation import Sound


def info(reel: ReelAddress, /, rendition: str | None = None, json: bool = False) -> None:
    """Show what a reel holds, and where its bytes are.

    Args:
        reel: Folder of the reel, or its URL: http(s), s3://BUCKET/REEL and the like (needs splatreel[cloud]).
        rendition: Rendition to look at, for a reel that has several; by default the best.
        json: Print everything as JSON.
    """
    from splatreel.codec.inspection import reel_info

    location = reel_folder(reel)
    found = reel_info(location, rendition)
    if json:
        values = dataclasses.asdict(found) | {"manifest": json_format.loads(found.manifest.without_pages().to_json())}
        say(json_format.dumps(values, indent=1))
    else:
        say(describe(str(location), found))


def describe(name: str, found: ReelInfo) -> str:
    """Return the summary of a reel: totals, groups and sections."""
    manifest = found.manifest
    width, height = manifest.camera.width, manifest.camera.height
    count = manifest.frames - manifest.first_frame
    seconds = count / manifest.fps
    state = "still growing, " if manifest.live else ""
    lines = [
        f"{name}: {state}made by {manifest.generator or 'an unnamed program'}",
        f"  {count} frames at {manifest.fps:g} a second, {seconds:.2f} s, from {width} x {height} pixels",
        f"  {len(manifest.cameras)} cameras; color depends on the view by spherical harmonics of degree {manifest.sh_degree}",
        f"  {found.total_bytes:,} bytes to watch once, {found.bytes_per_second:,.0f} for each second of video",
        f"  {found.start_bytes:,} of these before the first complete image, then {found.playing_bytes_per_second:,.0f} a second",
        *([f"  {found.stored_bytes:,} bytes in all files"] if found.stored_bytes != found.total_bytes else []),
        f"  as plain float32 numbers the points would be {found.float32_bytes:,} bytes",
    ]
    layers, groups = sum(found.layer_bytes), sum(found.group_bytes)
    parts = {"layers": layers, "groups": groups, "manifest": found.bytes - layers - groups}
    parts |= {"images and sound": found.total_bytes - found.bytes}
    shares = (f"{kind} {size:,} ({size / found.total_bytes:.1%})" for kind, size in parts.items() if size)
    lines.append(f"  of these: {', '.join(shares)}")
    if found.rendition_bytes:
        rates = [
            f"{name} {size:,} bytes ({8e-6 * size / seconds:.2f} Mbit/s)"
            for name, size in found.rendition_bytes.items()
        ]
        lines.append(f"  groups in renditions: {', '.join(rates)}")
    lines += presentation_lines(manifest)
    lines += group_lines(manifest)
    points = {"layer": manifest.layers, "group": manifest.groups}
    for kind, sections in found.section_bytes.items():
        count = max(sum(file.points for file in points[kind]), 1)
        parts = [f"{section} {size:,} ({8 * size / count:.1f})" for section, size in sections.items()]
        if parts:
            lines.append(f"  sections of the {kind}s, in bytes (and bits a point): {', '.join(parts)}")
    return "\n".join([*lines, *rate_chart(manifest)])


def group_lines(manifest: Manifest) -> list[str]:
    """Return a line for each group about its dynamic points and its new static points."""
    points, sizes = Counter[int](), Counter[int]()
    for layer in manifest.layers:
        points[layer.group] += layer.points
        sizes[layer.group] += layer.bytes
    return [
        f"  group {group.group}: frames {group.first_frame} to {group.end - 1}, "
        f"{group.points:,} dynamic points ({group.bytes:,} bytes), "
        + (
            f"{points[group.group]:,} new static points ({sizes[group.group]:,} bytes)"
            if group.group in points
            else "no new static points"
        )
        for group in manifest.groups
    ]


def presentation_lines(manifest: Manifest) -> list[str]:
    """Return lines about texts, images and sound of a reel."""
    from splatreel.codec.presentation import MAX_TEXT

    said = manifest.presentation
    texts = {name: getattr(said, name) for name in MAX_TEXT}
    sizes = {
        "poster": said.poster.asset.bytes if said.poster else 0,
        "thumbnails": sum(sheet.bytes for sheet in said.thumbnails.sheets) if said.thumbnails else 0,
        "sound": sum(asset.bytes for asset in said.sound.assets) if said.sound else 0,
    }
    lines = [f"  {name}: {text}" for name, text in texts.items() if text]
    beside = ", ".join(f"{name} {size:,} bytes" for name, size in sizes.items() if size)
    if said.sound:
        lines.append(f"  {describe_sound(said.sound)}")
    return [*lines, *([f"  beside the points: {beside}"] if beside else [])]


def describe_sound(sound: Sound) -> str:
    """Return a description of the sound."""
    seconds = sum(segment.seconds for segment in sound.segments)
    rate = 8e-3 * sum(segment.asset.bytes for segment in sound.segments) / seconds
    where = f"heard from {', '.join(f'{x:.3g}' for x in sound.position)}" if sound.position else "from no place"
    channels = "1 channel" if sound.channels == 1 else f"{sound.channels} channels"
    return f"sound: {seconds:.2f} s, {channels}, {rate:.0f} kbit/s, {where}"


ROWS, BAR = 24, 48
"""Number of lines of the chart of the rate, and of characters of its longest bar."""


def rate_chart(manifest: Manifest) -> list[str]:
    """Return a chart of the megabits per second that a player fetches: group files, and the layers that groups add, drawn lighter."""
    groups, born = manifest.groups, Counter[int]()
    if not groups:
        return []
    for layer in manifest.layers:
        born[layer.group] += layer.bytes
    ends = [group.first_frame for group in groups[1:]] + [manifest.frames]
    per_row = -(-len(groups) // ROWS)
    rows = []
    for first in range(0, len(groups), per_row):
        last = min(first + per_row, len(groups)) - 1
        seconds = max(ends[last] - groups[first].first_frame, 1) / manifest.fps
        own = sum(group.bytes for group in groups[first : last + 1])
        layers = sum(born[group.group] for group in groups[first : last + 1])
        rows.append((groups[first].first_frame / manifest.fps, 8e-6 * own / seconds, 8e-6 * layers / seconds))
    top = max(own + layers for _, own, layers in rows) or 1.0
    lines = ["  rate over time, Mbit/s (█ groups, ░ new static points)"]
    for start, own, layers in rows:
        bar = "█" * round(BAR * own / top) + "░" * round(BAR * layers / top)
        lines.append(f"  {start:8.2f} s  {own + layers:7.2f}  {bar}".rstrip())
    return lines


def verify(reel: ReelAddress, /, max_memory: int | None = None) -> None:
    """Check that a reel is complete and undamaged: file lengths, digests, and that every file decodes.

    Args:
        reel: Folder of the reel, or its URL: http(s), s3://BUCKET/REEL and the like (needs splatreel[cloud]).
        max_memory: Megabytes that decoding a file may take; by default what a correct file of its length needs.
    """
    from splatreel.codec.inspection import verify_reel

    location = reel_folder(reel)
    found = verify_reel(location, megabytes(max_memory))
    groups, layers = counted(found.groups, "group"), counted(found.layers, "layer")
    say(f"{location}: complete and undamaged: {groups}, {layers}, {found.points:,} points, {found.bytes:,} bytes")
    if found.strangers:
        files = counted(len(found.strangers), "file")
        say(f"  {files} that the manifest does not name, which players never read: {', '.join(found.strangers[:5])}")
