"""Poses that RealityCapture (RealityScan) exports as XMP, one file `IMAGE.xmp` beside each image.

`Rotation` [3, 3] row by row is world to camera in OpenCV's axes, and `Position` is the camera's position. Lengths in the
image are relative to its longer side: the principal point is an offset from the image's center, and the focal length is
that of a 36 mm wide film. DistortionCoeficients are k1, k2, k3, k4, t1, t2 of Brown's model; OpenCV's p1 is t2 and p2 is
t1. The files do not state the image's size.

Source: "RealityCapture XMP Camera Math" (Capturing Reality, 2020 to 2022), and the export template "OpenCV-compliant
Internal/External Camera Parameters" of RealityScan 2.2, whose order is k1, k2, t2, t1, k3, k4.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import open_regular
from splatreel.capture.readers.calibrations.calibrated_rig import (
    Rig,
    RigCamera,
    brown_lens,
    floats,
    naming,
    pose,
    read_xml,
)

FILM = 36.0
"""Width of the film in millimeters to which focal lengths refer."""
RADIAL = ("brown3", "brown4", "brown3t2", "brown4t2")
NAMESPACE = b"capturingreality.com/ns/xcr"
LOOKED_AT, XMP_BYTES = 20, 1 << 16
"""Maximum number of files, and of bytes of each, in which the namespace is looked for."""
SQUARE = 1e-6
"""Maximum skew, and deviation of the aspect ratio of pixels from 1."""


def xmp_folders(path: Path) -> list[Path]:
    """Return a folder, or its folder `images`, if there are XMP files of RealityCapture. Other programs write such files too."""
    return [folder for folder in (path, path / "images") if any(map(_is_own, _files(folder)[:LOOKED_AT]))]


def _files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.glob("*.xmp") if not file.name.startswith("."))


def _is_own(file: Path) -> bool:
    try:
        with open_regular(file, CaptureError) as opened:
            return NAMESPACE in opened.read(XMP_BYTES)
    except (OSError, CaptureError):
        return False


def read_realitycapture(folder: Path) -> Rig:
    """Return the cameras of the XMP files in a folder. Files without a pose are left out."""
    cameras, unposed = [], []
    for file in _files(folder):
        values = _values(read_xml(file))
        if "Rotation" in values and "Position" in values:
            cameras.append(_camera(file, values))
        else:
            unposed.append(file.name)
    if not cameras:
        raise CaptureError(
            f"{folder}: its XMP files hold no poses. Export them with RealityCapture: Registration > XMP, with camera poses."
        )
    notes = [f"{folder}: without a pose, and left out: {', '.join(unposed)}"] if unposed else []
    return Rig(folder, cameras, notes=notes)


def _values(root: Element) -> dict[str, str]:
    found: dict[str, str] = {}
    for node in root.iter():
        found |= {key.rpartition("}")[2]: value for key, value in node.attrib.items() if "capturingreality" in key}
        if "capturingreality" in node.tag and node.text:
            found[node.tag.rpartition("}")[2]] = node.text
    return found


def _camera(file: Path, values: dict[str, str]) -> RigCamera:
    with naming(str(file)):
        rotation = floats(values["Rotation"], 9).reshape(3, 3)
        center = floats(values["Position"], 3)
        focal = floats(values["FocalLength35mm"], 1)[0] / FILM
        offset = [floats(values.get(f"PrincipalPoint{axis}", "0"), 1)[0] for axis in "UV"]
        bends = floats(values.get("DistortionCoeficients", "0 0 0 0 0 0"), 6)
        skew, aspect = floats(values.get("Skew", "0"), 1)[0], floats(values.get("AspectRatio", "1"), 1)[0]
    model = values.get("DistortionModel", "perspective")
    if (model != "perspective" and model not in RADIAL and bends.any()) or abs(skew) + abs(aspect - 1) > SQUARE:
        raise CaptureError(
            f"{file}: has the lens {model} with skew {skew:g} and aspect ratio {aspect:g}. Read are {', '.join(RADIAL)} with square "
            f"pixels: align with one of them, or export undistorted images."
        )
    if model == "perspective":
        bends[:] = 0

    def lens(width: int, height: int) -> Any:
        side = max(width, height)
        pinhole = [focal * side, focal * side, width / 2 + offset[0] * side, height / 2 + offset[1] * side]
        return brown_lens(str(file), (width, height), pinhole, bends[:4].tolist(), [bends[5], bends[4]])

    return RigCamera(file.stem, pose(str(file), rotation, -rotation @ center), None, lens)
