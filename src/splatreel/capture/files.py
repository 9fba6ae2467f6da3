"""Access to a capture's videos and images, local or remote. Of remote files only the needed parts are fetched."""

from __future__ import annotations

import re
import tempfile
import weakref
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO, cast

import av
from av.container import InputContainer
from av.stream import Disposition

from splatreel.base.atomic import scratch
from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import check_regular, open_regular
from splatreel.storage.address import Address, local_path

MEDIA = re.compile(
    r".*\.(mp4|mov|m4v|mkv|webm|avi|m?2?ts|mxf|mpe?g|3gp|wmv|flv|jpe?g|png|webp|tiff?|bmp|wav|flac|mp3|m4a|aac|ogg|opus)",
    re.IGNORECASE,
)
"""Files that are read in parts. All others are small and describe the cameras."""


def natural_key(name: str) -> tuple[str | int, ...]:
    """Return a key that sorts names by their numbers, such as `2.jpg` before `10.jpg`."""
    return tuple(int(part) if part.isascii() and part.isdigit() else part for part in re.split("([0-9]+)", name))


def list_folder(folder: Path) -> list[Path]:
    """Return the entries of a folder by their numbers, without hidden ones such as `._cam00.mp4`; none without the folder."""
    if not folder.is_dir():
        return []
    found = (entry for entry in folder.iterdir() if not entry.name.startswith("."))
    return sorted(found, key=lambda entry: (natural_key(entry.name), entry.name))


class Files:
    """Access to files by their local paths. These files are on this machine."""

    def source(self, path: Path) -> Any:
        """Return an argument for PyAV and Pillow: a path or an open file. Raise `CaptureError` for a pipe, a device or a folder."""
        check_regular(path, CaptureError)
        return str(path)

    def raw(self, path: Path) -> BinaryIO:
        """Open a file for random access. Raise `CaptureError` for a pipe, a device or a folder."""
        return open_regular(path, CaptureError)


LOCAL = Files()


BRIEFLY = {"analyzeduration": "100000", "fpsprobesize": "0"}
"""FFmpeg options that analyze only the first frames of a file instead of five megabytes."""


def open_media(files: Files, path: Path, options: dict[str, str] | None = None) -> InputContainer:
    """Open a video or sound file with options of FFmpeg's demuxers. PyAV's errors pass through."""
    return cast(InputContainer, av.open(files.source(path), "r", options=options or {}))


def main_video(container: InputContainer) -> av.VideoStream | None:
    """Return the video stream that players show: no cover, the default one, the largest; None without video."""

    def rank(stream: av.VideoStream) -> tuple[bool, bool, int, int]:
        area = stream.codec_context.width * stream.codec_context.height
        found = stream.disposition
        return bool(found & Disposition.attached_pic), not found & Disposition.default, -area, stream.index

    return min(container.streams.video, key=rank, default=None)


class RemoteFiles(Files):
    """Files at an address such as `s3://BUCKET/CAPTURE`, mirrored by a local folder.

    In the folder, small files are copies. Videos and images are sparse files of the right size, whose content is
    fetched when it is read. The folder is deleted with this object.

    Args:
        url: Address of the folder.

    Raises:
        CaptureError: There is nothing at the address.
        StorageError: The address cannot be reached.
    """

    def __init__(self, url: str) -> None:
        self._address = Address(url)
        self._sizes = self._address.sizes()
        if not self._sizes:
            raise CaptureError(f"{self._address}: there are no files. Give the address of a folder with files.")
        stack = ExitStack()
        self._remove = weakref.finalize(self, stack.close)
        place = stack.enter_context(scratch(Path(tempfile.gettempdir()), "splatreel-capture"))
        self.root = place / str(self._address).rpartition("/")[2]
        for name, size in self._sizes.items():
            self._place(name, size)

    def source(self, path: Path) -> Any:
        """Return an argument for PyAV and Pillow."""
        return self.raw(path) if path.is_relative_to(self.root) else super().source(path)

    def raw(self, path: Path) -> BinaryIO:
        """Open a file for random access."""
        if not path.is_relative_to(self.root):
            return super().raw(path)
        name = path.relative_to(self.root).as_posix()
        if name not in self._sizes:
            raise FileNotFoundError(f"{self._address.name(name)} is missing")
        return cast(BinaryIO, self._address.open(name, self._sizes[name]))

    def _place(self, name: str, size: int) -> None:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if MEDIA.fullmatch(name):
            with open(path, "wb") as file:
                file.truncate(size)
        else:
            path.write_bytes(self._address.read_range(name, 0, size))


def locate_files(folder: str | Path) -> tuple[Files, Path]:
    """Return the access to the files of a folder or an address, and the local folder that stands for it."""
    path = local_path(folder)
    if path is not None:
        return LOCAL, path
    files = RemoteFiles(str(folder))
    return files, files.root
