"""What can be done with a folder wherever it lies, and such a folder on a disk."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from splatreel.errors import StorageError
from splatreel.scene.atomic import replacing, sweep

_NAME = re.compile(r"[^/\\.\x00-\x1f][^/\\\x00-\x1f]*(/[^/\\.\x00-\x1f][^/\\\x00-\x1f]*)*")

REFUSALS = (PermissionError, FileNotFoundError, NotADirectoryError, IsADirectoryError)
"""Errors that are not the line's fault: to try again changes nothing."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
"""What a disk says that has no room, or takes nothing: nor does it change by itself."""


@dataclass(frozen=True)
class Headers:
    """What a web host says of a file: its `Content-Type` and `Cache-Control`."""

    type: str = "application/octet-stream"
    caching: str = "no-cache"


PLAIN = Headers()


class Folder(Protocol):
    """Files by their path within a folder, `/` between the parts. All methods raise `StorageError` where the place cannot be reached
    or refuses, and may be called again then."""

    def address(self, name: str) -> str:
        """What to call a file in messages."""
        ...

    def read(self, name: str, most: int) -> bytes | None:
        """The first `most` bytes of a file; None where there is none."""
        ...

    def read_range(self, name: str, begin: int, end: int) -> bytes:
        """Return the bytes from begin to end (exclusive) of a file; fewer at its end. A missing file is an error."""
        ...

    def write(self, name: str, data: bytes, headers: Headers = PLAIN) -> None:
        """Make or replace a file: others find the old one or the new one, whole."""
        ...

    def sizes(self, prefix: str = "") -> dict[str, int]:
        """Bytes of all files whose name begins so, also in folders within it; no file whose name begins with a dot."""
        ...

    def remove(self, name: str) -> None:
        """Delete a file; one that is not there is no error."""
        ...


def is_plain(name: str) -> bool:
    """Whether a name stays within a folder: no part of it is empty, hidden, or leads upwards."""
    return _NAME.fullmatch(name) is not None


class LocalFolder:
    """A folder on a disk; it is made when something is written into it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def address(self, name: str) -> str:
        return str(self.path / name)

    def read(self, name: str, most: int) -> bytes | None:
        try:
            with open(self.path / name, "rb") as file:
                return file.read(most)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise self._failed(name, "cannot be read", error) from error

    def read_range(self, name: str, begin: int, end: int) -> bytes:
        try:
            with open(self.path / name, "rb") as file:
                file.seek(begin)
                return file.read(max(end - begin, 0))
        except OSError as error:
            raise self._failed(name, "cannot be read", error) from error

    def write(self, name: str, data: bytes, headers: Headers = PLAIN) -> None:
        path = self.path / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            sweep(path.parent, path.name)
            with replacing(path) as temporary:
                temporary.write_bytes(data)
        except OSError as error:
            raise self._failed(name, f"could not be written ({len(data)} bytes)", error) from error

    def sizes(self, prefix: str = "") -> dict[str, int]:
        try:
            return {name: size for name, size in self._walk() if name.startswith(prefix)}
        except OSError as error:
            raise self._failed(prefix, "cannot be listed", error) from error

    def remove(self, name: str) -> None:
        try:
            (self.path / name).unlink(missing_ok=True)
        except OSError as error:
            raise self._failed(name, "cannot be deleted", error) from error

    def _walk(self) -> Iterator[tuple[str, int]]:
        for folder, folders, files in os.walk(self.path):
            folders[:] = [name for name in folders if not name.startswith(".")]
            for path in (Path(folder, name) for name in files):
                with contextlib.suppress(FileNotFoundError):  # deleted since
                    if is_plain(name := path.relative_to(self.path).as_posix()):
                        yield name, path.stat().st_size

    def _failed(self, name: str, what: str, error: OSError) -> StorageError:
        lasting = isinstance(error, REFUSALS) or error.errno in _FULL
        return StorageError(f"{self.address(name)}: {what} ({error.strerror or error}).", lasting=lasting)
