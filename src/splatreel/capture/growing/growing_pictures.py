"""A folder of numbered pictures a camera, to which more are being added."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from splatreel.capture.frame_table import FrameTable
from splatreel.capture.growing.segmented_video import Numbered, numbered
from splatreel.capture.images import image_size, read_image
from splatreel.capture.sidecar import SIDECAR, Sidecar
from splatreel.capture.soundtrack import Track
from splatreel.errors import CaptureError

END_MARKS = {".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9", ".png": b"IEND\xaeB`\x82"}
"""The last bytes of a picture."""


class GrowingPictures:
    """The pictures of all cameras, which count one by one from the same number on. They start together.

    A picture counts when it is whole and all before it are. fps: what the sidecar says, or 30: pictures do not tell.
    """

    def __init__(self, path: Path, files: dict[str, list[Path]], sidecar: Sidecar) -> None:
        self.path = path
        self.fps = sidecar.fps or 30.0
        if sidecar.starts:
            raise CaptureError(
                f"{path / SIDECAR}: says when videos start, but the cameras have pictures. Remove `starts`."
            )
        self._names = {name: _numbered(found) for name, found in files.items()}
        starts = {names.start for names in self._names.values()}
        if len(starts) > 1:
            late = max(self._names, key=lambda name: self._names[name].start)
            raise CaptureError(
                f"{path}: the pictures of {late} begin at {self._names[late].file(0).name}, others' at number {min(starts)}. All "
                f"cameras' pictures count from the same number on, one by one."
            )
        self._counts = dict.fromkeys(self._names, 0)
        self.update()

    def size(self, name: str) -> tuple[int, int]:
        """(width, height) of a camera's first picture."""
        return image_size(self._names[name].file(0))

    @property
    def frames(self) -> int:
        """Time steps that are whole in all cameras."""
        return min(self._counts.values(), default=0)

    def counts(self) -> dict[str, int]:
        """By camera, how many time steps of it are whole."""
        return dict(self._counts)

    def waiting_for(self, name: str) -> Path:
        """The file that will be a camera's next frame."""
        return self._names[name].file(self._counts[name])

    def update(self) -> None:
        """Look for what was written."""
        for name, names in self._names.items():
            while is_whole(names.file(self._counts[name])):
                self._counts[name] += 1

    def settle(self) -> None:
        """Once the capture has ended: the last look."""
        self.update()

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Time steps first .. first + len(out) - 1 of a camera into out [count, H, W, 3] uint8."""
        for index, picture in enumerate(out):
            picture[:] = read_image(self._names[name].file(first + index), out.shape[2], out.shape[1])

    def sources(self, first: int, count: int) -> list[Path]:
        return [names.folder for names in self._names.values()]

    def tables(self) -> dict[Path, FrameTable]:
        """Nothing: pictures need none."""
        return {}

    def tracks(self, first: int) -> dict[str, Track]:
        """Pictures have none."""
        return {}

    def close(self) -> None:
        """Nothing is held open."""


def is_whole(file: Path) -> bool:
    """Whether a picture is there and nobody is still writing it."""
    if not file.is_file():
        return False  # a pipe would be waited for
    try:
        mark = END_MARKS.get(file.suffix.lower())
        if mark is not None:
            with open(file, "rb") as opened:
                opened.seek(max(file.stat().st_size - len(mark), 0))
                if opened.read() == mark:
                    return True
        with Image.open(file) as image:  # other formats, and files with something behind the picture
            image.load()
        return True
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError):
        return False


def _numbered(files: list[Path]) -> Numbered:
    names = numbered(files)
    assert names is not None
    return names
