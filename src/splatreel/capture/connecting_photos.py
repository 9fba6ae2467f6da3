"""Photographs that connect the views of cameras which have too little in common, made ready for COLMAP."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from splatreel.capture.image_sequences import image_files
from splatreel.capture.images import image_size
from splatreel.errors import CaptureError
from splatreel.progress import Progress

PHOTO_FOLDER = "also/"
"""Their folder among the cameras' pictures, which have none of their own."""
LONGEST = 2400
"""Pixels that they are reduced to: more tell COLMAP hardly more."""


def check_photos(folder: Path) -> list[Path]:
    """The photographs of a folder. Raises `CaptureError` where there are none, or one cannot be read."""
    if not folder.is_dir():
        raise CaptureError(f"{folder}: is not a folder. Name a folder of photographs.")
    files = image_files(folder)
    if not files:
        raise CaptureError(f"{folder}: holds no photographs (JPEG, PNG, WebP, TIFF or BMP). Copy them there.")
    for file in files:
        image_size(file)
    return files


def write_photos(files: list[Path], pictures: Path, progress: Progress) -> list[str]:
    """Upright copies of photographs in the folder `pictures`, those of one size together: they share a lens. Returns their names."""
    names = []
    progress.stage("reading photographs", len(files))
    for number, file in enumerate(files):
        try:
            with Image.open(file) as opened:
                image = ImageOps.exif_transpose(opened).convert("RGB")
        except (OSError, ValueError, Image.DecompressionBombError) as error:
            raise CaptureError(
                f"{file}: cannot be read as a picture ({error}). Copy it again or leave it out."
            ) from error
        image.thumbnail((LONGEST, LONGEST), Image.Resampling.LANCZOS)
        name = f"{PHOTO_FOLDER}{image.width}x{image.height}/{number:05d}.jpg"
        (pictures / name).parent.mkdir(parents=True, exist_ok=True)
        image.save(pictures / name, quality=95)
        names.append(name)
        progress.update(number + 1)
    return names


def write_picture(file: Path, picture: np.ndarray) -> None:
    """A frame [H, W, 3] uint8 as a PNG of its own size."""
    Image.fromarray(picture).save(file, compress_level=1)
