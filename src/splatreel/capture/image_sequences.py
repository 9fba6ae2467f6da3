"""Image files, one per camera and time step."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.base import MIN_CAMERAS, Request
from splatreel.capture.camera_images import CameraImages
from splatreel.capture.capture_sound import Track
from splatreel.capture.files import list_folder
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.gaps import describe_gaps, nearest
from splatreel.capture.own_frames import OwnFrames
from splatreel.capture.sidecar import SIDECAR, Sidecar

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")
FRAME_FIRST = re.compile(r"(?:frame|image|img|f)?[-_]?\d+[-_. ]+(?P<camera>\D.*)", re.IGNORECASE)
CAMERA_FIRST = re.compile(r"(?P<camera>.*[^\W_].*?)[-_. ]+\D*?\d+")
"""Names of images with the number of a frame and a camera, as 0001_cam00 and cam00_0001."""


class ImageSequences:
    """Image files of a capture by camera in order of time. All cameras start together.

    Attributes:
        frames: Number of time steps.
        fps: Frame rate of the sidecar, or 30.
        notes: Sentences about what was chosen or skipped.

    Args:
        path: Folder of the capture.
        files: By camera a file per time step; None where the camera has none.
        sidecar: Content of `splatreel.json`.
        request: Options.
        notes: Sentences about the choice of the files.
        labels: Number of each time step in messages; by default counted from 0.
        upright: True obeys EXIF as OpenCV does, False ignores it as COLMAP does.

    Raises:
        CaptureError: The cameras have different numbers of time steps, or the sidecar has start times.
    """

    def __init__(
        self,
        path: Path,
        files: Mapping[str, Sequence[Path | None]],
        sidecar: Sidecar,
        request: Request,
        notes: Sequence[str] = (),
        labels: Sequence[int] | None = None,
        *,
        upright: bool = True,
    ) -> None:
        self.notes = list(notes)
        self.fps = sidecar.fps or 30.0
        if sidecar.starts:
            raise CaptureError(
                f"{path / SIDECAR}: has start times of videos, but the cameras have images. Remove `starts`."
            )
        files = {name: found for name, found in files.items() if name not in request.left_out}
        counts = {name: len(found) for name, found in files.items()}
        self.frames = min(counts.values(), default=0)
        if len(set(counts.values())) > 1:
            low, high = min(counts, key=lambda n: counts[n]), max(counts, key=lambda n: counts[n])
            raise CaptureError(
                f"{path}: the cameras have unequal numbers of images: {low} has {counts[low]}, {high} has {counts[high]}. Add "
                f"those that are missing."
            )
        self._exists = {name: np.array([file is not None for file in found]) for name, found in files.items()}
        for name, there in self._exists.items():
            if not there.any():
                raise CaptureError(f"{path}: camera {name} has no images. Add them, or leave the camera out.")
        lacks = {name: ~there for name, there in self._exists.items()}
        self.notes += describe_gaps(lacks, range(self.frames) if labels is None else labels, "images")
        self._files = {name: _stand_ins(found, self._exists[name]) for name, found in files.items()}
        start = 0 if request.frames is None else min(request.frames[0], self.frames - 1)
        first = {name: found[start] for name, found in self._files.items()}
        self._images = CameraImages(first, request.files, upright)

    def size(self, name: str, calibrated: tuple[int, int] | None = None) -> tuple[int, int]:
        """Return width and height of a camera's images (`CameraImages.size`)."""
        return self._images.size(name, calibrated)

    def conversions(self) -> list[str]:
        """Return sentences about conversions of the images that users should know of."""
        return self._images.conversions()

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Read time steps from `first` on of a camera into out [count, H, W, 3] uint8."""
        for image, file in zip(out, self._files[name][first : first + len(out)], strict=True):
            self._images.read(image, name, file)

    def missing(self, first: int, count: int, name: str) -> np.ndarray:
        """Return [count] bool, the time steps for which a camera has no image. The nearest image stands in for it."""
        return ~self._exists[name][first : first + count]

    def own_frames(self, name: str) -> OwnFrames:
        """Return the images that a camera has."""
        there = self._exists[name]
        shown = np.asarray(nearest(there))
        stems = [self._files[name][at].stem for at in np.flatnonzero(there)]
        return OwnFrames((np.cumsum(there) - 1)[shown], len(stems), stems)

    def sources(self, first: int, count: int) -> list[Path]:
        """Return the files that are read."""
        files = (file for found in self._files.values() for file in found[first : first + count])
        return list(dict.fromkeys(files))

    def tables(self) -> dict[Path, FrameTable]:
        """Return nothing, because images have no frame tables."""
        return {}

    def tracks(self, first: int) -> dict[str, Track]:
        """Return nothing, because images have no sound."""
        return {}

    def close(self) -> None:
        """Do nothing, because no files stay open."""


def image_files(folder: Path) -> list[Path]:
    """Return the image files in a folder, sorted by the numbers in their names."""
    return [file for file in list_folder(folder) if file.suffix.lower() in IMAGE_SUFFIXES and file.is_file()]


def flat_images(folder: Path) -> str | None:
    """Return advice about a folder that holds the images of several cameras itself, such as cam00_0001.png, or None."""
    files = image_files(folder)
    for pattern in (FRAME_FIRST, CAMERA_FIRST):
        found = [pattern.fullmatch(file.stem) for file in files]
        cameras = Counter(match["camera"] for match in found if match)
        if len(cameras) >= MIN_CAMERAS and sum(cameras.values()) == len(files) and max(cameras.values()) > 1:
            camera, file = next((match["camera"], file) for match, file in zip(found, files, strict=True) if match)
            example = f"{camera}/{file.name}"
            return (
                f"{folder} holds the images of {len(cameras)} cameras in one folder, such as {file.name}. Move the images of each "
                f"camera into a folder of its own, such as {example}."
            )
    return None


def _stand_ins(files: Sequence[Path | None], exists: np.ndarray) -> list[Path]:
    """Return the file of each time step, or the nearest in time."""
    return [file for at in nearest(exists) if (file := files[at]) is not None]
