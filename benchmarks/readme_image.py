"""Draw the README's image: a held-out camera of the built-in capture at a few times, rendered from the decoded reel.

python benchmarks/readme_image.py out/demo/reel
"""

from pathlib import Path

import numpy as np
import tyro
from PIL import Image

import splatreel
from record import ROOT
from splatreel.capture.builtin.synthetic import make_cameras


def main(
    reel: tyro.conf.Positional[Path],
    /,
    camera: str = "cam00",
    seconds: tuple[float, ...] = (0.1, 0.9, 1.7),
    width: int = 400,
    out: Path = ROOT / "docs" / "images" / "demo.jpg",
) -> None:
    """Render and write the images side by side.

    Args:
        width: Width of each image, pixels.
    """
    timeline = splatreel.open_reel(reel)
    manifest = timeline.manifest
    view = next(c for c in make_cameras(manifest.camera.width, manifest.camera.height) if c.name == camera)
    size = width, round(width * view.height / view.width)
    images = []
    for time in seconds:
        image = timeline.render(timeline.at(time), view)
        pixels = np.rint(image.clip(0, 1) * 255).astype(np.uint8)
        images.append(np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.LANCZOS)))
    gap = np.full((size[1], 6, 3), 255, np.uint8)
    strip = np.concatenate([part for image in images for part in (image, gap)][:-1], axis=1)
    out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(strip).save(out, quality=85, optimize=True, progressive=True)  # below 100 kB
    print(f"{out}: {out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    tyro.cli(main)
