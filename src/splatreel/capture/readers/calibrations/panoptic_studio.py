"""Calibrations of the CMU Panoptic Studio: `calibration_SEQUENCE.json` beside `hdVideos/` or `hdImgs/`.

A camera has `name` (panel and node), `type`, `resolution`, `K` [3, 3], `distCoef` (k1, k2, p1, p2, k3), `R` [3, 3] and `t`
[3], world to camera, in centimeters. The toolbox projects as cv2.projectPoints does, so the center of the first pixel is
at (0, 0). The 31 HD cameras are read. Their videos are `hd_00_05.mp4`, and `00_05/00_05_00000000.jpg` their images. VGA
and Kinect cameras have other times and are not read.

Source: panoptic-toolbox (commit 246ebcf), `README.md`, `python/panutils.py`, `scripts/hdImgsExtractor.sh`.
"""

from __future__ import annotations

from pathlib import Path

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import read_json
from splatreel.capture.readers.calibrations.calibrated_rig import Rig, RigCamera, image_size, naming, opencv_lens, pose


def is_panoptic_studio(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of a Panoptic Studio calibration."""
    return file.suffix.lower() == ".json" and all(key in head for key in (b'"panel"', b'"node"', b'"distCoef"'))


def read_panoptic_studio(file: Path) -> Rig:
    """Return the HD cameras."""
    content = read_json(file, CaptureError)
    with naming(str(file)):
        found = [entry for entry in content["cameras"] if entry["type"] == "hd"]
    cameras = []
    for entry in found:
        whose = f"{file}: camera {entry.get('name')}"
        with naming(whose):
            name, size = str(entry["name"]), image_size(entry["resolution"])
            lens = opencv_lens(whose, entry["K"], entry["distCoef"], size)
            viewmat = pose(whose, entry["R"], entry["t"])
        cameras.append(RigCamera(name, viewmat, size, lambda *_, lens=lens: lens))
    if not cameras:
        raise CaptureError(f"{file}: holds no HD cameras, which are the ones that are read.")
    return Rig(file, cameras, partial=True)
