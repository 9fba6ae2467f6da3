"""`splatreel verify`."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from splatreel.cli.options import megabytes, reel_folder
from splatreel.cli.output import counted, say


def verify(reel: Positional[Path], /, max_memory: int | None = None) -> None:
    """Check that a reel is whole: lengths, digests, and that every file decodes.

    Args:
        reel: Folder of the reel.
        max_memory: Megabytes that decoding a file may take; by default what one of its length honestly needs.
    """
    from splatreel.codec.verify import verify_reel

    reel = reel_folder(reel)
    found = verify_reel(reel, megabytes(max_memory))
    groups, layers = counted(found.groups, "group"), counted(found.layers, "layer")
    say(
        f"{reel}: whole, every byte is what the manifest says: {groups}, {layers}, {found.points:,} points, {found.bytes:,} bytes"
    )
    if found.strangers:
        files = counted(len(found.strangers), "file")
        say(f"  {files} that players never read, as the manifest does not name them: {', '.join(found.strangers[:5])}")
