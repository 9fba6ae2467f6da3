"""Interface of a folder, and its implementation on a local disk."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from splatreel.base.atomic import remove, replacing, sweep
from splatreel.base.errors import StorageError
from splatreel.base.untrusted import open_regular

_NAME = re.compile(r"[^/\\.\x00-\x1f][^/\\\x00-\x1f]*(/[^/\\.\x00-\x1f][^/\\\x00-\x1f]*)*")

REFUSALS = (PermissionError, FileNotFoundError, NotADirectoryError, IsADirectoryError)
"""Errors that a retry does not fix, unlike connection errors."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
"""Error numbers of a full or read-only disk, which a retry does not fix."""


@dataclass(frozen=True)
class Headers:
    """HTTP headers that a web host sends with a file: `Content-Type` and `Cache-Control`."""

    type: str = "application/octet-stream"
    caching: str = "no-cache"


PLAIN = Headers()


class Folder(Protocol):
    """Files named by their paths within a folder, with `/` as separator.

    All methods raise `StorageError` if the folder cannot be reached or refuses access. Every method may be called again
    afterwards.
    """

    def address(self, name: str) -> str:
        """Return the name of a file for messages."""
        ...

    def read(self, name: str, most: int) -> bytes | None:
        """Return the first `most` bytes of a file, or None if the file does not exist."""
        ...

    def read_range(self, name: str, begin: int, end: int) -> bytes:
        """Return the bytes from `begin` to `end` (exclusive), fewer at the end of the file. A missing file is an error."""
        ...

    def write(self, name: str, data: bytes, headers: Headers = PLAIN) -> None:
        """Create or replace a file. Readers see the old content or the new content, never a part."""
        ...

    def sizes(self, prefix: str = "") -> dict[str, int]:
        """Return the sizes in bytes of all files whose name starts with `prefix`, including subfolders but not hidden files."""
        ...

    def remove(self, name: str) -> None:
        """Delete a file. A missing file is not an error."""
        ...


def is_plain(name: str) -> bool:
    """Return whether a name stays within a folder: no part is empty, hidden or leads upwards."""
    return _NAME.fullmatch(name) is not None


class LocalFolder:
    """Folder on a local disk, created by the first write."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def address(self, name: str) -> str:
        """Return the name of a file for messages."""
        return str(self.path / name)

    def read(self, name: str, most: int) -> bytes | None:
        """Return the first `most` bytes of a file, or None."""
        try:
            with open_regular(self.path / name, StorageError) as file:
                return file.read(most)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise self._failed(name, "cannot be read", error) from error

    def read_range(self, name: str, begin: int, end: int) -> bytes:
        """Return the bytes from `begin` to `end` (exclusive) of a file."""
        try:
            with open_regular(self.path / name, StorageError) as file:
                file.seek(begin)
                return file.read(max(end - begin, 0))
        except OSError as error:
            raise self._failed(name, "cannot be read", error) from error

    def write(self, name: str, data: bytes, headers: Headers = PLAIN) -> None:
        """Create or replace a file."""
        path = self.path / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            sweep(path.parent, path.name)
            with replacing(path) as temporary:
                temporary.write_bytes(data)
        except OSError as error:
            raise self._failed(name, f"could not be written ({len(data)} bytes)", error) from error

    def sizes(self, prefix: str = "") -> dict[str, int]:
        """Return the sizes of files by name."""
        try:
            return {name: size for name, size in self._walk() if name.startswith(prefix)}
        except OSError as error:
            raise self._failed(prefix, "cannot be listed", error) from error

    def remove(self, name: str) -> None:
        """Delete a file."""
        try:
            remove(self.path / name)
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
