"""The videos and pictures of a capture: in a folder of this machine, or elsewhere, where only what is needed of them is fetched."""

from __future__ import annotations

import re
import tempfile
import weakref
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO, Protocol, cast

import av
from av.container import InputContainer

from splatreel.errors import CaptureError
from splatreel.scene.atomic import scratch
from splatreel.storage.addresses import open_folder
from splatreel.storage.ranged_file import RangedFile
from splatreel.storage.retrying import RetryingFolder

MEDIA = re.compile(
    r".*\.(mp4|mov|m4v|mkv|webm|avi|m?ts|jpe?g|png|webp|tiff?|bmp|wav|flac|mp3|m4a|aac|ogg|opus)", re.IGNORECASE
)
"""Files that are read in place. All others are small, and say where the cameras are."""


class Files(Protocol):
    """Files by their path on this machine."""

    def source(self, path: Path) -> Any:
        """Return what PyAV and Pillow open: a path, or an open file."""
        ...

    def raw(self, path: Path) -> BinaryIO:
        """Open a file to be read in places. Raises OSError."""
        ...


class LocalFiles:
    """Files that lie where their paths say."""

    def source(self, path: Path) -> Any:
        return str(path)

    def raw(self, path: Path) -> BinaryIO:
        return open(path, "rb")


LOCAL = LocalFiles()


BRIEFLY = {"analyzeduration": "100000", "fpsprobesize": "0"}
"""FFmpeg looks only at the first pictures of a file, not at five megabytes of it."""


def open_media(files: Files, path: Path, options: dict[str, str] | None = None) -> InputContainer:
    """Open a video or a file of sound, with options of FFmpeg's demultiplexers. Raises what PyAV raises."""
    return cast(InputContainer, av.open(files.source(path), "r", options=options or {}))


class RemoteCaptureFiles:
    """A capture at an address such as `s3://BUCKET/CAPTURE`, and a folder on this machine that looks like it.

    In the folder, small files are copies. Videos and pictures are empty files of the right size that take no room on the disk; what is
    in them is fetched when it is read. The folder is deleted with this object.

    Args:
        url: The capture's folder, as `open_folder` takes it.

    Raises:
        CaptureError: There is nothing at the address.
        StorageError: The address cannot be reached.
    """

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        self._folder = RetryingFolder(open_folder(self.url))
        self._sizes = self._folder.sizes()
        if not self._sizes:
            raise CaptureError(
                f"{self.url}: there are no files. Give the address of the folder that holds the capture."
            )
        stack = ExitStack()
        self._remove = weakref.finalize(self, stack.close)
        place = stack.enter_context(scratch(Path(tempfile.gettempdir()), "splatreel-capture"))
        self.root = place / self.url.rpartition("/")[2]
        for name, size in self._sizes.items():
            self._place(name, size)

    def source(self, path: Path) -> Any:
        return self.raw(path) if path.is_relative_to(self.root) else str(path)

    def raw(self, path: Path) -> BinaryIO:
        if not path.is_relative_to(self.root):
            return open(path, "rb")
        name = path.relative_to(self.root).as_posix()
        if name not in self._sizes:
            raise FileNotFoundError(f"{self._folder.address(name)} is missing")
        return cast(BinaryIO, RangedFile(self._folder, name, self._sizes[name]))

    def _place(self, name: str, size: int) -> None:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if MEDIA.fullmatch(name):
            with open(path, "wb") as file:
                file.truncate(size)
        else:
            path.write_bytes(self._folder.read_range(name, 0, size))
