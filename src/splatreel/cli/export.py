"""`splatreel export`."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from splatreel.cli.options import reel_folder
from splatreel.errors import UsageError


def export(reel: Positional[Path], /, frame: int, out: Path) -> None:
    """Write one frame of a reel as a standard 3DGS PLY file.

    Args:
        reel: Folder of the reel.
        frame: Which frame, counted from 0.
        out: The PLY file to write.
    """
    from splatreel.play.timeline import open_reel
    from splatreel.scene.ply import write_ply

    source = open_reel(reel_folder(reel))
    manifest = source.manifest
    if not 0 <= frame < manifest.frames:
        raise UsageError(f"{reel}: there is no frame {frame}; choose 0 to {manifest.frames - 1}.")
    gaussians = source.at(frame / manifest.fps)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_ply(out, gaussians)
    print(f"{out}: {len(gaussians):,} Gaussians of frame {frame}")
