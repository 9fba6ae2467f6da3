"""Calibrations that OpenCV's FileStorage wrote, in YAML or XML.

Either one file holds all cameras, as OpenCV's `apps/multiview-calibration` writes it: `cam_ids`, `Ks` [N, 3, 3], `Rs` and
`Ts` from the first camera's system to the camera's, `distortions`, `models` (1 is `cv2.fisheye`) and `image_sizes`. Or a
file per camera, named as the camera, holds a matrix, distortion coefficients, a rotation and a translation, world to
camera, under one of the names below. The center of the first pixel is at (0, 0). EasyMocap's and EasyVolcap's intri.yml
and extri.yml have a reader of their own.

Source: opencv 5.x, `apps/multiview-calibration/multiview_calibration.py` (`saveToFile`); the OpenCV tutorial "Camera
calibration With OpenCV" for `camera_matrix` and `distortion_coefficients`.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.readers.calibrations.calibrated_rig import (
    Rig,
    RigCamera,
    image_size,
    naming,
    opencv_lens,
    pose,
    read_text,
    read_xml,
)

_MATRIX = re.compile(
    r"^([\w.-]+):\s*!!opencv-(?:nd-)?matrix\s+(rows:\s*\d+\s+cols:\s*\d+|sizes:\s*\[[^\[\]]*\])\s+dt:\s*\S+\s+data:\s*"
    r"\[([^\[\]]*)\]",  # an unclosed bracket ends at the next one, so that the search stays linear
    re.MULTILINE,
)
SCALAR = re.compile(r"^([\w.-]+):[ \t]*([^\s!\[{\"][^\n]*)$", re.MULTILINE)
TEXT = re.compile(r'^(\w+):[ \t]*"([^"\n]*)"[ \t]*$', re.MULTILINE)
LIST = re.compile(r"^(\w+):[ \t]*((?:\n[ \t]+-[^\n]*)+|\[[^\[\]]*\])", re.MULTILINE)
ENTRY = re.compile(r'"([^"]*)"|([^\s,\[\]"]+)')


class OpenCVStorage:
    """Matrices, numbers and strings by key of a file that OpenCV's FileStorage wrote. Values of other kinds are ignored.

    OpenCV's own parser is not used, because it can crash on damaged files.

    Attributes:
        known: Keys of all values that were recognized.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self._matrices: dict[str, tuple[list[int], str]] = {}
        self._scalars: dict[str, str] = {}
        self._strings: dict[str, list[str]] = {}
        with naming(str(file)):
            if file.suffix.lower() == ".xml":
                for node in read_xml(file):
                    self._add_xml(node)
            else:
                self._add_yaml(read_text(file).replace("\r\n", "\n"))
        self.known = {*self._matrices, *self._scalars, *self._strings}

    def first(self, keys: tuple[str, ...]) -> np.ndarray | None:
        """Return the first existing matrix or number, or None."""
        return next((self.matrix(key) for key in keys if key in self._matrices or key in self._scalars), None)

    def matrix(self, key: str) -> np.ndarray:
        """Return a matrix or a number as float64.

        Raises:
            CaptureError: It is missing, or not of finite numbers.
        """
        with naming(f"{self.file}: {key}"):
            if key in self._scalars:
                return np.array(self.number(key))
            if key not in self._matrices:
                raise CaptureError(f"{self.file}: has no matrix {key}. Export the calibration again.")
            shape, text = self._matrices[key]
            values = np.array(text.replace(",", " ").split(), np.float64)
            if not np.isfinite(values).all() or len(values) == 0 or len(values) % max(math.prod(shape), 1):
                raise ValueError(f"{len(values)} numbers for the shape {shape}, or not finite ones")
            return values.reshape(shape if len(values) == math.prod(shape) else [*shape, -1])

    def number(self, key: str) -> float | None:
        """Return a number, or None if there is no such key.

        Raises:
            CaptureError: The value is not a finite number.
        """
        text = self._scalars.get(key)
        if text is None:
            return None
        with naming(f"{self.file}: {key} is {text[:40]!r}, no finite number"):
            if not math.isfinite(value := float(text)):
                raise ValueError("it is infinite or NaN")
            return value

    def strings(self, key: str) -> list[str]:
        """Return a list of strings, which older versions wrote as one string with commas."""
        found = self._strings.get(key, [])
        return [part.strip() for part in found[0].split(",")] if len(found) == 1 else found

    def _add_yaml(self, text: str) -> None:
        for key, shape, data in _MATRIX.findall(text):
            self._matrices[key] = [int(number) for number in re.findall(r"\d+", shape)], data
        self._scalars = {key: value.rstrip(" \t") for key, value in SCALAR.findall(text)}
        self._strings = {key: _entries(part) for key, part in LIST.findall(text)}
        self._strings |= {key: [value] for key, value in TEXT.findall(text)}

    def _add_xml(self, node: Element) -> None:
        data = node.findtext("data")
        if data is None:
            text = " ".join(node.itertext()).strip()
            self._strings[node.tag] = [first or second for first, second in ENTRY.findall(text)]
            if re.fullmatch(r"[-+.\deE]+", text):
                self._scalars[node.tag] = text
            return
        sizes = node.findtext("sizes") or f"{node.findtext('rows', '')} {node.findtext('cols', '')}"
        self._matrices[node.tag] = [int(number) for number in re.findall(r"\d+", sizes)], data


def _entries(text: str) -> list[str]:
    """Return the entries of a list in lines with dashes or in brackets."""
    text = text.strip()
    parts = text[1:-1].split(",") if text.startswith("[") else [line.strip()[1:] for line in text.splitlines()]
    return [part.strip().strip('"') for part in parts if part.strip()]


SUFFIXES = (".yml", ".yaml", ".xml")
MATRIX = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "intrinsic_matrix", "K", "M", "mtx")
DISTORTIONS = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "distortion_coeffs",
    "distCoeffs",
    "dist_coeffs",
    "dist",
    "D",
)
ROTATION = ("rotation_matrix", "Rot", "R", "rvec", "rotation_vector", "rotation")
TRANSLATION = ("translation_vector", "translation", "T", "t", "tvec")
WIDTH, HEIGHT = ("image_width", "image_Width", "width", "W"), ("image_height", "image_Height", "height", "H")
FISHEYE = 1
"""Value of cv2.CALIB_MODEL_FISHEYE."""


def is_multiview(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of a multi-view calibration."""
    return _is_storage(file, head) and all(_has(head, (key,)) for key in ("Rs", "Ks", "distortions"))


def is_camera(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of one camera with a pose."""
    return _is_storage(file, head) and all(_has(head, keys) for keys in (MATRIX, ROTATION, TRANSLATION))


def read_multiview(file: Path) -> Rig:
    """Return the cameras of a multi-view calibration."""
    storage = OpenCVStorage(file)
    Ks, rotations, translations = (storage.matrix(key) for key in ("Ks", "Rs", "Ts"))
    models, sizes = storage.matrix("models").ravel(), storage.matrix("image_sizes").reshape(-1, 2)
    count = len(Ks)
    names = storage.strings("cam_ids") or [str(number) for number in range(count)]
    bends = storage.matrix("distortions").ravel()
    each = [4 if model == FISHEYE else 0 for model in models]
    pinholes = each.count(0)
    share, rest = divmod(len(bends) - sum(each), pinholes) if pinholes else (0, len(bends) - sum(each))
    if rest or share < 0 or {len(rotations), len(translations), len(models), len(sizes), len(names)} != {count}:
        raise CaptureError(
            f"{file}: has {count} matrices, {len(rotations)} rotations, {len(translations)} translations, {len(models)} models, "
            f"{len(sizes)} image sizes, {len(names)} names and {len(bends)} distortion coefficients, which do not fit together. Export "
            f"it again."
        )
    cameras, used = [], 0
    for c, name in enumerate(names):
        length = each[c] or share
        cameras.append(
            _camera(
                f"{file}: camera {name}",
                name,
                (Ks[c], bends[used : used + length]),
                (rotations[c], translations[c]),
                sizes[c],
                models[c] == FISHEYE,
            )
        )
        used += length
    return Rig(file, cameras)


def read_cameras(files: list[Path]) -> Rig:
    """Return the cameras of a file per camera."""
    cameras = []
    for file in files:
        storage = OpenCVStorage(file)
        found = [storage.first(keys) for keys in (MATRIX, DISTORTIONS, ROTATION, TRANSLATION, WIDTH, HEIGHT)]
        for value, keys in zip(found, (MATRIX, DISTORTIONS, ROTATION, TRANSLATION), strict=False):
            if value is None:
                raise CaptureError(f"{file}: has none of {', '.join(keys)}. Export the camera again.")
        matrix, bends, rotation, translation, width, height = found
        size = None if width is None or height is None else np.array([width, height]).ravel()
        cameras.append(_camera(str(file), file.stem, (matrix, bends), (rotation, translation), size, False))
    return Rig(files[0].parent, cameras)


def _camera(
    whose: str, name: str, lens: tuple[Any, Any], place: tuple[Any, Any], size: np.ndarray | None, fisheye: bool
) -> RigCamera:
    with naming(whose):
        known = None if size is None else image_size(size.astype(np.float64).tolist())
    viewmat = pose(whose, *place)
    return RigCamera(name, viewmat, known, lambda *shape: opencv_lens(whose, *lens, known or shape, fisheye))


def _is_storage(file: Path, head: bytes) -> bool:
    return file.suffix.lower() in SUFFIXES and (head.lstrip().startswith(b"%YAML") or b"<opencv_storage" in head)


def _has(head: bytes, keys: tuple[str, ...]) -> bool:
    lines = {line.strip().partition(b":")[0] for line in head.splitlines() if not line.startswith(b" ")}
    return any(key.encode() in lines or f"<{key} ".encode() in head or f"<{key}>".encode() in head for key in keys)
