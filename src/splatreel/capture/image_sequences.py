"""Image files, one per camera and time step: complete sequences, and ones that are still being written."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from splatreel.base.errors import CaptureError
from splatreel.capture.base import MIN_CAMERAS, Request
from splatreel.capture.capture_sound import Track
from splatreel.capture.files import LOCAL, list_folder
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.growth import is_recorded
from splatreel.capture.images import CameraImages
from splatreel.capture.segmented_video import Numbered, numbered
from splatreel.capture.sidecar import SIDECAR, Sidecar
from splatreel.capture.time_steps import OwnFrames, describe_gaps, nearest, pair_images

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")
FRAME_FIRST = re.compile(r"(?:frame|image|img|f)?[-_]?\d+[-_. ]+(?P<camera>\D.*)", re.IGNORECASE)
CAMERA_FIRST = re.compile(r"(?P<camera>.*[^\W_].*?)[-_. ]+\D*?\d+")
"""Names of images with the number of a frame and a camera, as 0001_cam00 and cam00_0001."""


class _CameraSequences:
    """Images of a capture by camera."""

    _images: CameraImages

    def size(self, name: str, calibrated: tuple[int, int] | None = None) -> tuple[int, int]:
        """Return width and height of a camera's images (`CameraImages.size`)."""
        return self._images.size(name, calibrated)

    def conversions(self) -> list[str]:
        """Return sentences about conversions of the images that users should know of."""
        return self._images.conversions()

    def tables(self) -> dict[Path, FrameTable]:
        """Return nothing, because images have no frame tables."""
        return {}

    def tracks(self, first: int) -> dict[str, Track]:
        """Return nothing, because images have no sound."""
        return {}

    def close(self) -> None:
        """Do nothing, because no files stay open."""


class ImageSequences(_CameraSequences):
    """Image files of a capture by camera in order of time. All cameras start together.

    Attributes:
        fps: Frame rate of the sidecar, or 30.

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
        self.fps = _frame_rate(path, sidecar)
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


def _frame_rate(path: Path, sidecar: Sidecar) -> float:
    if sidecar.starts:
        raise CaptureError(
            f"{path / SIDECAR}: has start times of videos, but the cameras have images. Remove `starts`."
        )
    return sidecar.fps or 30.0


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


LOOKED, FOLLOWING = 60, 5
"""Numbers after a missing image at which the next one is searched, and images that must follow before it counts as lost."""
END_MARKS = {".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9", ".png": b"IEND\xaeB`\x82"}
"""Last bytes of a complete image."""


class GrowingImages(_CameraSequences):
    """Images of all cameras, numbered consecutively from the same number. They start together.

    An image counts when it and all earlier ones are complete. An image that was not written although later ones were is
    lost, and does not stop the others. The frame rate is the sidecar's, or 30. `upright` obeys EXIF.
    """

    def __init__(self, path: Path, files: dict[str, list[Path]], sidecar: Sidecar, *, upright: bool = True) -> None:
        self.path = path
        self.fps = _frame_rate(path, sidecar)
        self._names = {name: _numbered(found) for name, found in files.items()}
        starts = {names.start for names in self._names.values()}
        if len(starts) > 1:
            late = max(self._names, key=lambda name: self._names[name].start)
            raise CaptureError(
                f"{path}: the images of {late} begin at {self._names[late].file(0).name}, others' at number {min(starts)}. All "
                f"cameras' images count from the same number on, one by one."
            )
        self._images = CameraImages({name: names.file(0) for name, names in self._names.items()}, LOCAL, upright)
        self._counts = dict.fromkeys(self._names, 0)
        self._lost: dict[str, set[int]] = {name: set() for name in self._names}
        self.notes: list[str] = []
        self.update()

    @property
    def frames(self) -> int:
        """Number of time steps complete in all cameras."""
        return min(self._counts.values(), default=0)

    def counts(self) -> dict[str, int]:
        """Return the number of complete time steps by camera."""
        return dict(self._counts)

    def waiting_for(self, name: str) -> Path:
        """Return the file of a camera's next image."""
        return self._names[name].file(self._counts[name])

    def failure(self, name: str) -> str | None:
        """Return None, because a missing image may still come."""
        return None

    def update(self) -> None:
        """Check for new images."""
        self._look(FOLLOWING)

    def settle(self) -> None:
        """Check for the last time, after the capture has ended."""
        self._look(0)

    def _look(self, following: int) -> None:
        for name in self._names:
            while is_complete_image(self.waiting_for(name)) or self._skip_lost(name, following):
                self._counts[name] += 1

    def _skip_lost(self, name: str, following: int) -> bool:
        """Return whether the next image of a camera is lost: it does not exist, but a later one and `following` more do."""
        names, count = self._names[name], self._counts[name]
        if names.file(count).exists():
            return False
        later = next((n for n in range(count + 1, count + LOOKED) if names.file(n).exists()), None)
        if later is None or not is_complete_image(names.file(later + following)):
            return False
        self._lost[name].add(count)
        return True

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Read time steps from `first` on of a camera into out [count, H, W, 3] uint8."""
        for index, image in enumerate(out, first):
            while index in self._lost[name]:  # the image before stands in
                index -= 1
            self._images.read(image, name, self._names[name].file(index))

    def missing(self, first: int, count: int, name: str) -> np.ndarray:
        """Return [count] bool, the images that were lost."""
        return np.array([step in self._lost[name] for step in range(first, first + count)], bool)

    def sources(self, first: int, count: int) -> list[Path]:
        """Return the files that are read."""
        return [names.folder for names in self._names.values()]


def is_complete_image(file: Path) -> bool:
    """Return whether an image exists and is complete."""
    if not file.is_file():
        return False  # reading a pipe would block
    try:
        mark = END_MARKS.get(file.suffix.lower())
        if mark is not None:
            with LOCAL.raw(file) as opened:
                opened.seek(max(file.stat().st_size - len(mark), 0))
                if opened.read() == mark:
                    return True
        with Image.open(LOCAL.source(file)) as image:  # other formats, and files with data after the image
            image.load()
        return True
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError):
        return False


def _numbered(files: list[Path]) -> Numbered:
    names = numbered(files)
    assert names is not None
    return names


def image_source(
    path: Path, files: dict[str, list[Path]], sidecar: Sidecar, request: Request, *, upright: bool = True
) -> ImageSequences | GrowingImages:
    """Return the source for the images of each camera, which are paired by the numbers in their names.

    `upright` obeys EXIF.
    """
    files = {name: found for name, found in files.items() if name not in request.left_out}
    if request.growth is None:
        pairs = pair_images(path, files, all_have=is_recorded(path))
        return ImageSequences(path, pairs.files, sidecar, request, pairs.notes, pairs.labels, upright=upright)
    return GrowingImages(path, files, sidecar, upright=upright)
