"""`splatreel verify`."""

from __future__ import annotations

from splatreel.cli.options import ReelAddress, megabytes, reel_folder
from splatreel.cli.printing import counted, say


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
