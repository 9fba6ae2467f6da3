"""Write every frame of a reel as a PLY file, as 3DGS programs read them.

python examples/export_frames.py out/demo/reel --out frames
"""

from pathlib import Path

import tyro
from tyro.conf import Positional

import splatreel


def main(reel: Positional[str], out: Path = Path("frames"), every: int = 1) -> None:
    """Export the frames of a reel.

    Args:
        reel: Folder or URL of the reel.
        out: Folder to write into.
        every: Step between frames.
    """
    out.mkdir(parents=True, exist_ok=True)
    with splatreel.open_reel(reel) as timeline:
        numbers = range(0, len(timeline), every)
        for frame in numbers:
            splatreel.write_ply(out / f"{frame:05}.ply", timeline[frame])
    print(f"{out}: {len(numbers)} frames")


if __name__ == "__main__":
    tyro.cli(main)
