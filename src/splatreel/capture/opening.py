"""Recognise a capture's format and open it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from splatreel.capture.base import Capture, Request
from splatreel.capture.colmap import ColmapCapture, is_colmap
from splatreel.capture.neu3dv import Neu3DVCapture, is_neu3dv
from splatreel.capture.panoptic import PanopticCapture, is_panoptic
from splatreel.errors import CaptureError

LOOKED_FOR = """\
  Neu3DV:          poses_bounds.npy and cam00.mp4, cam01.mp4, ...
  Panoptic Sports: train_meta.json, test_meta.json and ims/
  COLMAP:          sparse/0/cameras.bin (or .txt) and a video a camera, or images/, images_2/, images_4/, images_8/
  Videos alone:    first run `splatreel capture calibrate` on them, and `splatreel capture sync` if they do not start together"""

READERS: tuple[tuple[Callable[[Path], bool], Callable[[Path, Request], Capture]], ...] = (
    (is_neu3dv, Neu3DVCapture),
    (is_panoptic, PanopticCapture),
    (is_colmap, ColmapCapture),
)


def open_capture(
    path: str | Path,
    *,
    width: int | None = None,
    scale: float | None = None,
    frames: tuple[int, int] | None = None,
    held_out: list[str] | None = None,
) -> Capture:
    """Open a capture folder of any known format.

    width: output width in pixels, or scale: output over input size; by default the input's size. frames: (first, end), end
    exclusive. held_out: names of cameras kept for evaluation; by default what the format says.
    Raises `CaptureError` where the folder is of no known format or its content cannot be used.
    """
    folder = Path(path)
    request = Request(width, scale, frames, held_out)
    for fits, reader in READERS:
        if fits(folder):
            return reader(folder, request)
    state = "holds none of these" if folder.is_dir() else "is not a folder; one of these was looked for"
    raise CaptureError(f"{folder}: {state}:\n{LOOKED_FOR}")
