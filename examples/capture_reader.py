"""Read a capture layout that Splatreel does not know, and reconstruct it.

python examples/capture_reader.py FOLDER --out out/mine

The layout of this example is a folder with `rig.json`, a list of cameras, and one folder of numbered images for each camera:

    rig.json    [{"name": "left", "viewmat": [4 rows of 4], "K": [3 rows of 3]}, ...]
    left/       0000.png, 0001.png, ...

`viewmat` is world to camera with OpenCV axes, and `K` is in pixels (docs/conventions.md). To add a reader to Splatreel itself, see
"Add a capture reader" in CONTRIBUTING.md.
"""

import json
from pathlib import Path

import numpy as np
import tyro
from tyro.conf import Positional

import splatreel
from splatreel.readers import FileCapture, ImageSequences, Request, Sidecar, image_files


class RigCapture(FileCapture):
    """A folder with `rig.json` and a folder of images for each camera. The first camera is held out by default."""

    def __init__(self, path: Path, request: Request) -> None:
        rig = json.loads((path / "rig.json").read_text(encoding="utf-8"))
        names = [entry["name"] for entry in rig]
        images = ImageSequences(path, {name: image_files(path / name) for name in names}, Sidecar(fps=30), request)
        cameras = []
        for entry in rig:
            width, height = images.size(entry["name"])
            camera = splatreel.Camera(entry["name"], np.array(entry["viewmat"]), np.array(entry["K"]), width, height)
            cameras.append(camera.resized(*request.size(width, height, path)))
        super().__init__(path, cameras, images, request, held_out=names[:1], origin=path / "rig.json")


def main(
    folder: Positional[Path], out: Path | None = None, frames: int | None = None, width: int | None = None
) -> None:
    """Open a capture, and reconstruct it if `out` is given.

    Args:
        folder: Folder of the capture.
        out: Folder of the run.
        frames: Number of frames to read; by default all.
        width: Width in pixels to read images at; by default their own.
    """
    capture = RigCapture(folder, Request(width=width, frames=None if frames is None else (0, frames)))
    first = capture.read(0, 1, [camera.name for camera in capture.cameras])  # [1, cameras, H, W, 3] uint8, sRGB
    print(f"{len(capture.cameras)} cameras, {capture.frames} frames of {first.shape[3]}x{first.shape[2]} pixels")
    if out is not None:
        splatreel.reconstruct(capture, out, splatreel.preset("draft"))


if __name__ == "__main__":
    tyro.cli(main)
