"""Recognize a capture's format and open it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from splatreel.capture.base import Capture, Request
from splatreel.capture.growing.growth import Growth
from splatreel.capture.readers.colmap import ColmapCapture, is_colmap
from splatreel.capture.readers.easyvolcap import EasyVolcapCapture, is_easyvolcap
from splatreel.capture.readers.neu3dv import Neu3DVCapture, is_neu3dv
from splatreel.capture.readers.panoptic import PanopticCapture, is_panoptic
from splatreel.capture.readers.technicolor import TechnicolorCapture, is_technicolor
from splatreel.capture.sidecar import failed
from splatreel.errors import CaptureError

LOOKED_FOR = """\
  Neu3DV:          poses_bounds.npy and cam00.mp4, cam01.mp4, ...
  Panoptic Sports: train_meta.json, test_meta.json and ims/
  Technicolor:     cameras_parameters.txt and SCENE_undist_FRAME_CAMERA.png
  EasyVolcap:      intri.yml, extri.yml and images/CAMERA/*.jpg or videos/CAMERA.mp4
  COLMAP:          sparse/0/cameras.bin (or .txt) and a video a camera, or images/, images_2/, ... with a picture or a folder a camera
  Videos alone:    first run `splatreel capture calibrate` on them, and `splatreel capture sync` if they do not start together"""

READERS: tuple[tuple[Callable[[Path], bool], Callable[[Path, Request], Capture]], ...] = (
    (is_neu3dv, Neu3DVCapture),
    (is_panoptic, PanopticCapture),
    (is_technicolor, TechnicolorCapture),
    (is_easyvolcap, EasyVolcapCapture),
    (is_colmap, ColmapCapture),
)


def open_capture(
    path: str | Path,
    *,
    width: int | None = None,
    scale: float | None = None,
    frames: tuple[int, int] | None = None,
    held_out: list[str] | None = None,
    growth: Growth | None = None,
) -> Capture:
    """Open a capture folder of any known format.

    width: output width in pixels, or scale: output over input size; by default the input's size. frames: (first, end), end
    exclusive. held_out: names of cameras kept for evaluation; by default what the format says. growth: of a capture that is still being
    written (`open_growing`).
    Raises `CaptureError` where the folder is of no known format or its content cannot be used.
    """
    folder = Path(path)
    request = Request(width, scale, frames, held_out, growth)
    for fits, reader in READERS:
        if fits(folder):
            check_files(folder)
            return reader(folder, request)
    if folder.is_dir() and (failure := failed(folder)) is not None:
        raise failure
    state = "holds none of these" if folder.is_dir() else "is not a folder; one of these was looked for"
    raise CaptureError(f"{folder}: {state}:\n{LOOKED_FOR}")


def check_files(folder: Path, depth: int = 3) -> None:
    """Raise `CaptureError` for what is neither a file nor a folder: reading a pipe waits until somebody writes into it."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir():
                if depth and not entry.name.startswith("."):
                    check_files(Path(entry.path), depth - 1)
            elif not entry.is_file() and os.path.exists(entry.path):
                raise CaptureError(f"{entry.path}: is neither a file nor a folder. Take it out of the capture.")
