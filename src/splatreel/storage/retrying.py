"""Retries with growing pauses after connection errors."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import TypeVar

from splatreel.base.errors import StorageError
from splatreel.storage.folder import PLAIN, Folder, Headers

T = TypeVar("T")
PAUSES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Seconds between attempts. A random share of up to a half is added, so that many machines do not retry together."""


def ignore_message(why: str) -> None:
    """Ignore a message."""


class RetryingFolder:
    """Folder whose methods are retried after an error.

    Args:
        folder: The folder to access.
        report: Called with the reason of each retry.
        pauses: Seconds before each retry. After the last one the error is raised.
    """

    def __init__(
        self, folder: Folder, report: Callable[[str], None] = ignore_message, pauses: tuple[float, ...] = PAUSES
    ) -> None:
        self._folder = folder
        self._report = report
        self._pauses = pauses

    def address(self, name: str) -> str:
        """Return the name of a file for messages."""
        return self._folder.address(name)

    def read(self, name: str, most: int) -> bytes | None:
        """Return the first `most` bytes of a file, or None."""
        return self._try(lambda: self._folder.read(name, most))

    def read_range(self, name: str, begin: int, end: int) -> bytes:
        """Return the bytes from `begin` to `end` (exclusive) of a file."""
        return self._try(lambda: self._folder.read_range(name, begin, end))

    def write(self, name: str, data: bytes, headers: Headers = PLAIN) -> None:
        """Create or replace a file."""
        self._try(lambda: self._folder.write(name, data, headers))

    def sizes(self, prefix: str = "") -> dict[str, int]:
        """Return the sizes of files by name."""
        return self._try(lambda: self._folder.sizes(prefix))

    def remove(self, name: str) -> None:
        """Delete a file."""
        self._try(lambda: self._folder.remove(name))

    def _try(self, action: Callable[[], T]) -> T:
        for pause in self._pauses:
            try:
                return action()
            except StorageError as error:
                if error.lasting:
                    raise
                self._report(f"{error} Retrying.")
                time.sleep(pause * (1 + random.random() / 2))
        return action()
