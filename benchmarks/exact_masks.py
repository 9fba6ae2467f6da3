"""Film the built-in scene or `juggle`, and trace the exact masks of its moving things for `few_cameras.py`.

python benchmarks/exact_masks.py juggle OUT --frames 6
"""

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import tyro
from tyro.conf import Positional

import juggle
from film import FPS
from toyroom import room as toys
from toyroom.capture import make_cameras, make_capture
from toyroom.raytracer import trace_cover, trace_static


def main(scene: Positional[Literal["builtin", "juggle"]], out: Positional[Path], /, frames: int = 6) -> None:
    """Write OUT/capture and OUT/masks/CAMERA/FRAME.png: white where moving things fill at least half of a pixel.

    Args:
        scene: The built-in capture, of which the moving toys are the subject, or `juggle`, with both people.
        out: Output folder.
        frames: Number of frames of `juggle`. The film of the built-in scene always has 60.
    """
    if scene == "builtin":
        frames = 60
        make_capture(out / "capture", frames=frames)
        cameras, still, light = make_cameras(), toys.standing(0), toys.LIGHT
    else:
        film = juggle.film()
        if not (out / "capture").exists():
            film.write(out / "capture", frames)
        cameras, still, light = film.cameras, film.still, film.light
    for camera in cameras:
        seen = trace_static(camera, still, light)
        folder = out / "masks" / camera.name
        folder.mkdir(parents=True, exist_ok=True)
        for t in range(frames):
            moving = toys.moving(t / FPS) if scene == "builtin" else juggle.moving(t / FPS)
            cover, _ = trace_cover(camera, seen, moving, np.ones(len(moving.solids), bool))
            cv2.imwrite(str(folder / f"{t:06d}.png"), np.where(cover >= 0.5, 255, 0).astype(np.uint8))


if __name__ == "__main__":
    tyro.cli(main)
