"""Write every frame of a reel as a PLY file, as 3DGS programs read them.

python examples/export_frames.py out/demo/reel --out frames
"""

from pathlib import Path

import tyro
from tyro.conf import Positional

import splatreel
from splatreel.scene.ply import write_ply


def main(reel: Positional[str], out: Path = Path("frames"), every: int = 1) -> None:
    """Export the frames of a reel.

    Args:
        reel: Folder or URL of the reel.
        out: Folder to write into.
        every: Step between frames.
    """
    timeline = splatreel.open_reel(reel)
    out.mkdir(parents=True, exist_ok=True)
    for frame in range(0, timeline.frames, every):
        write_ply(out / f"{frame:05}.ply", timeline.at(frame / timeline.fps))
    print(f"{out}: {len(range(0, timeline.frames, every))} frames")


if __name__ == "__main__":
    tyro.cli(main)
