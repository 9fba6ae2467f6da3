"""`splatreel verify`."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from splatreel.cli.options import reel_folder


def verify(reel: Positional[Path], /) -> None:
    """Check that a reel is whole: lengths, digests, and that every file decodes.

    Args:
        reel: Folder of the reel.
    """
    from splatreel.codec.verify import verify_reel

    reel = reel_folder(reel)
    found = verify_reel(reel)
    print(
        f"{reel}: whole, every byte is what the manifest says. {found.groups} groups and {found.layers} layers, "
        f"{found.points:,} points, {found.bytes:,} bytes"
    )
    if found.strangers:
        print(f"  {len(found.strangers)} files that the manifest does not name: {', '.join(found.strangers[:5])}")
