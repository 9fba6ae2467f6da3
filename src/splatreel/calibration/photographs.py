"""Photographs of a camera that is walked between the views of a rig, for its calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Progress
from splatreel.capture.image_sequences import image_files
from splatreel.capture.images import encode_image, image_size, read_whole_image

PHOTO_FOLDER = "also/"
"""Folder of the photographs among the cameras' images, which have no folder."""
LONGEST = 2400
"""Size in pixels to which photographs are reduced. More gives COLMAP little."""


def check_photos(folder: Path) -> list[Path]:
    """Return the photographs of a folder. Raise `CaptureError` if there are none or one cannot be read."""
    if not folder.is_dir():
        raise CaptureError(f"{folder}: is not a folder. Name a folder of photographs.")
    files = image_files(folder)
    if not files:
        raise CaptureError(f"{folder}: holds no photographs (JPEG, PNG, WebP, TIFF or BMP). Copy them there.")
    for file in files:
        image_size(file)
    return files


def write_photos(files: list[Path], images: Path, progress: Progress) -> list[str]:
    """Write upright copies of photographs, grouped by size, since equal sizes share a lens. Return their names."""
    names = []
    progress.stage("reading photographs", len(files))
    for number, file in enumerate(files):
        image = Image.fromarray(read_whole_image(file))
        image.thumbnail((LONGEST, LONGEST), Image.Resampling.LANCZOS)
        name = f"{PHOTO_FOLDER}{image.width}x{image.height}/{number:05d}.jpg"
        (images / name).parent.mkdir(parents=True, exist_ok=True)
        (images / name).write_bytes(encode_image(image, ".jpg", quality=95))
        names.append(name)
        progress.update(number + 1)
    return names


def write_image(file: Path, image: np.ndarray) -> None:
    """Write a frame [H, W, 3] uint8 as a PNG file."""
    file.write_bytes(encode_image(image, file.suffix, compress_level=1))
