"""Folders of numbered images, one per camera, that are still being written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from splatreel.base.errors import CaptureError
from splatreel.capture.camera_images import CameraImages
from splatreel.capture.capture_sound import Track
from splatreel.capture.files import LOCAL
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.growing.segmented_video import Numbered, numbered
from splatreel.capture.sidecar import SIDECAR, Sidecar

LOOKED, FOLLOWING = 60, 5
"""Numbers after a missing image at which the next one is searched, and images that must follow before it counts as lost."""
END_MARKS = {".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9", ".png": b"IEND\xaeB`\x82"}
"""Last bytes of a complete image."""


class GrowingImages:
    """Images of all cameras, numbered consecutively from the same number. They start together.

    An image counts when it and all earlier ones are complete. An image that was not written although later ones were is
    lost, and does not stop the others. The frame rate is the sidecar's, or 30. `upright` obeys EXIF.
    """

    def __init__(self, path: Path, files: dict[str, list[Path]], sidecar: Sidecar, *, upright: bool = True) -> None:
        self.path = path
        self.fps = sidecar.fps or 30.0
        if sidecar.starts:
            raise CaptureError(
                f"{path / SIDECAR}: has start times of videos, but the cameras have images. Remove `starts`."
            )
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

    def size(self, name: str, calibrated: tuple[int, int] | None = None) -> tuple[int, int]:
        """Return width and height of a camera's images (`CameraImages.size`)."""
        return self._images.size(name, calibrated)

    def conversions(self) -> list[str]:
        """Return sentences about conversions of the images that users should know of."""
        return self._images.conversions()

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

    def tables(self) -> dict[Path, FrameTable]:
        """Return nothing, because images have no frame tables."""
        return {}

    def tracks(self, first: int) -> dict[str, Track]:
        """Return nothing, because images have no sound."""
        return {}

    def close(self) -> None:
        """Do nothing, because no files stay open."""


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
