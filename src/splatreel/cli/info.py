"""`splatreel info`."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from splatreel.cli.options import reel_folder

if TYPE_CHECKING:
    from splatreel.codec.manifest import Manifest


def info(reel: Positional[Path], /, json: bool = False) -> None:
    """Say what a reel holds, from its manifest alone.

    Args:
        reel: Folder of the reel.
        json: Print the manifest instead, as JSON.
    """
    from splatreel.codec.reader import ReelReader

    reel = reel_folder(reel)
    manifest = ReelReader(reel).manifest
    print(json_format.dumps(json_format.loads(manifest.to_json())) if json else describe(str(reel), manifest))


def describe(name: str, manifest: Manifest) -> str:
    """The summary of a manifest, a line for each group."""
    seconds = manifest.frames / manifest.fps
    total = sum(entry.bytes for entry in (*manifest.layers, *manifest.groups))
    width, height = manifest.camera.width, manifest.camera.height
    lines = [
        f"{name}: {'still growing, ' if manifest.live else ''}made by {manifest.generator or 'an unnamed program'}",
        f"  {manifest.frames} frames at {manifest.fps:g} a second, {seconds:.2f} s; from {width} x {height} pixels",
        f"  {len(manifest.cameras)} cameras, spherical harmonics to degree {manifest.sh_degree}",
        f"  {total:,} bytes, {total / seconds:,.0f} a second" if seconds else "  no group yet",
    ]
    for group in manifest.groups:
        born = next((layer for layer in manifest.layers if layer.group == group.group), None)
        new = f"{born.points:,} new static points ({born.bytes:,} bytes)" if born else "no new static points"
        last = group.first_frame + group.frames - 1
        lines.append(
            f"  group {group.group}: frames {group.first_frame}-{last}, "
            f"{group.points:,} dynamic points ({group.bytes:,} bytes), {new}"
        )
    return "\n".join(lines)
