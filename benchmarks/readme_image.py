"""Draw the moving picture of the README: the sample reel of the package, played while the camera moves around the scene.

python benchmarks/readme_image.py
"""

import math
from pathlib import Path

import numpy as np
import tyro
from PIL import Image

import splatreel
from record import ROOT
from splatreel.play.demo_page import SAMPLE
from splatreel.scene.camera import facing
from toyroom.capture import RADIUS, TARGET

SIDEWAYS, MIDDLE, UPWARDS = 24.0, 16.0, 7.0
"""Largest azimuth, mean elevation and largest difference from it, in degrees: within the training cameras."""


def main(
    reel: Path = SAMPLE,
    out: Path = ROOT / "docs" / "images" / "reel.webp",
    width: int = 480,
    fps: int = 15,
    plays: int = 2,
    quality: int = 60,
) -> None:
    """Render the frames and write them as an animated WebP that repeats.

    Args:
        reel: A reel of the built-in scene.
        out: File to write.
        width: Width in pixels.
        fps: Frames per second of the picture.
        plays: Number of times that the reel plays during one turn of the camera.
        quality: Quality of WebP, 0 to 100.
    """
    timeline = splatreel.open_reel(reel)
    seconds = timeline.manifest.frames / timeline.manifest.fps
    count = round(seconds * fps) * plays
    images = []
    for frame in range(count):
        turn = 2 * math.pi * frame / count
        azimuth = math.radians(SIDEWAYS * math.sin(turn))
        elevation = math.radians(MIDDLE + UPWARDS * math.cos(turn))
        place = (math.sin(azimuth) * math.cos(elevation), math.sin(elevation), math.cos(azimuth) * math.cos(elevation))
        offset = RADIUS * np.array(place)
        view = facing("view", TARGET + offset, -offset / RADIUS, 1.2 * width, width, width * 3 // 4)
        # Twice the size, reduced: smoother edges, which also take fewer bytes.
        large = view.resized(2 * view.width, 2 * view.height)
        image = timeline.render(timeline.at(frame / fps % seconds), large)
        pixels = Image.fromarray(np.rint(image.clip(0, 1) * 255).astype(np.uint8))
        images.append(pixels.resize((view.width, view.height), Image.Resampling.LANCZOS))
    out.parent.mkdir(parents=True, exist_ok=True)
    images[0].save(
        out, save_all=True, append_images=images[1:], duration=round(1000 / fps), loop=0, quality=quality, method=6
    )
    print(f"{out}: {count} frames, {out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    tyro.cli(main)
