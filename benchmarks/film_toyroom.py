"""Film the toy room, as the package ships it or in another size.

python benchmarks/film_toyroom.py OUT --frames 30
"""

from contextlib import closing
from pathlib import Path

import tyro
from tyro.conf import Positional

from splatreel.base.display import console
from toyroom.capture import make_capture


def main(
    out: Positional[Path], /, width: int = 256, height: int = 192, frames: int = 60, seed: int = 0, trace: bool = True
) -> None:
    """Write a Neu3DV folder, at 30 frames a second.

    Args:
        out: New folder.
        width: Width of the videos in pixels, even.
        height: Height of the videos in pixels, even.
        frames: Number of frames of the videos.
        seed: Variation of textures and small objects.
        trace: Trace the film even if the package contains it. The result is the same.
    """
    with closing(console()) as progress:
        progress.stage("filming the toy room", 100)
        make_capture(
            out,
            width=width,
            height=height,
            frames=frames,
            seed=seed,
            trace=trace,
            progress=lambda share: progress.update(round(100 * share)),
        )


if __name__ == "__main__":
    tyro.cli(main)
