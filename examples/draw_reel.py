"""Open a reel and draw one of its frames.

python examples/draw_reel.py out/demo/reel --seconds 0.5 --out image.png
"""

from pathlib import Path

import numpy as np
import tyro
from PIL import Image
from tyro.conf import Positional

import splatreel


def main(reel: Positional[str], seconds: float = 0.5, out: Path = Path("picture.png")) -> None:
    """Draw a reel.

    Args:
        reel: Folder or URL of the reel, or output folder of a run.
        seconds: Time of the frame.
        out: Image to write.
    """
    timeline = splatreel.open_reel(reel)
    gaussians = timeline.at(seconds)
    image = timeline.render(gaussians, timeline.manifest.camera)  # [H, W, 3] float32, sRGB, 0..1
    Image.fromarray((image * 255).round().astype(np.uint8)).save(out)
    print(f"{out}: {len(gaussians)} Gaussians at {seconds} s of {timeline.duration:.1f} s")


if __name__ == "__main__":
    tyro.cli(main)
