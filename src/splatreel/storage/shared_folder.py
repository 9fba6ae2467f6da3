"""File exchange between machines without a common disk, through one shared folder."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from splatreel.base.atomic import replacing, sweep
from splatreel.base.errors import StorageError
from splatreel.storage.addresses import open_folder
from splatreel.storage.folder import is_plain
from splatreel.storage.retrying import PAUSES, RetryingFolder, ignore_message

_KEPT = re.compile(r"(?P<name>.+)@(?P<version>[0-9]{6})-(?P<sha256>[0-9a-f]{64})", re.DOTALL)
_EACH = 2
"""Up to this many files at the top level are looked up by name; for more, the whole folder is listed."""
_LISTINGS = 3
"""Attempts to fetch files that are replaced during the fetch."""


@dataclass(frozen=True)
class SharedFile:
    """Newest version of a file in the shared folder."""

    name: str
    bytes: int
    sha256: str
    version: int

    @property
    def key(self) -> str:
        """Name in the shared folder, for example `keyframe.safetensors@000000-SHA256`."""
        return f"{self.name}@{self.version:06d}-{self.sha256}"


class SharedFolder:
    """Folder at any address of `open_folder`, for files that machines push and pull.

    The stored name contains the version and the digest of a file. One listing therefore shows all changes, no reader
    finds a partial file, and versions need no clock. Any number of machines may push at a time if no two of them push a
    file of the same name.

    Args:
        url: Address of the folder.
        report: Called with the reason of each retry.
        pauses: Seconds before each retry.

    Raises:
        UsageError: The address is invalid.
        MissingDependencyError: A required package is not installed.
        StorageError: Raised by the methods if the folder cannot be reached.
    """

    def __init__(
        self, url: str | Path, report: Callable[[str], None] = ignore_message, pauses: tuple[float, ...] = PAUSES
    ) -> None:
        self._url = str(url)
        self._known: dict[str, list[SharedFile]] = {}
        """Versions of files that this process pushed. No other process pushes them, so they are not listed again."""
        self._folder = RetryingFolder(open_folder(url), report, pauses)

    def files(self, prefix: str = "") -> dict[str, SharedFile]:
        """Return the newest version of each file whose name starts with `prefix`."""
        return _newest(self._versions(prefix))

    def push(self, folder: Path, names: Iterable[str]) -> list[str]:
        """Upload changed files in the given order.

        Args:
            folder: Local folder.
            names: Paths within the folder.

        Returns:
            Names of the files that had changed.

        Raises:
            StorageError: A local file is missing, or a path leads out of the folder.
        """
        names, sent = list(names), []
        self._look_up([name for name in names if name not in self._known])
        for name in names:
            data = _read(folder, name)
            versions = self._known[name]
            digest, there = hashlib.sha256(data).hexdigest(), _newest(versions).get(name)
            if there is None or (there.bytes, there.sha256) != (len(data), digest):
                there = SharedFile(name, len(data), digest, 0 if there is None else there.version + 1)
                self._folder.write(there.key, data)
                sent.append(name)
            for old in versions:
                if old != there:
                    self._folder.remove(old.key)
            self._known[name] = [there]
        return sent

    def _look_up(self, names: list[str]) -> None:
        """List the versions of files that were not pushed from here, with as few listings as possible."""
        prefixes = {f"{name.rpartition('/')[0]}/" if "/" in name else f"{name}@" for name in names}
        if sum("/" not in prefix for prefix in prefixes) > _EACH:
            prefixes = {""}
        found = [version for prefix in sorted(prefixes) for version in self._versions(prefix)]
        for name in names:
            self._known[name] = [version for version in found if version.name == name]

    def pull(self, names: Iterable[str], into: Path, listed: dict[str, SharedFile] | None = None) -> list[str]:
        """Download files in the given order. Files that are already present are kept.

        Args:
            names: Paths within the folder.
            into: Local folder.
            listed: A recent result of `files`; None lists the folder.

        Returns:
            Names of the downloaded files, sorted.

        Raises:
            StorageError: The shared folder lacks a file, or a stored file is damaged.
        """
        names = list(dict.fromkeys(names))
        return self._pull(_common(names), names, into, listed)

    def pull_all(self, prefix: str, into: Path) -> list[str]:
        """Download all files whose name starts with `prefix`, as `pull` does. Zero matching files are not an error."""
        return self._pull(prefix, None, into)

    def _pull(
        self, prefix: str, names: list[str] | None, into: Path, listed: dict[str, SharedFile] | None = None
    ) -> list[str]:
        fetched: list[str] = []
        for _ in range(_LISTINGS):
            files, listed = self.files(prefix) if listed is None else listed, None
            if missing := [name for name in names or () if name not in files]:
                raise StorageError(
                    f"{self._url}: has no file {missing[0]!r:.200}. Has the job that writes it finished?"
                )
            wanted = sorted(files) if names is None else names
            left = [files[name] for name in wanted if not _is_here(into, files[name])]
            found = [file.name for file in left if self._fetch(file, into)]
            fetched += found
            if len(found) == len(left):
                return sorted(set(fetched))
        raise StorageError(f"{self._url}: files there change faster than they can be fetched. Try again later.")

    def _fetch(self, file: SharedFile, into: Path) -> bool:
        """Download one file. Return False if it was replaced since the listing."""
        data = self._folder.read(file.key, file.bytes + 1) if file.bytes else b""
        if data is None:
            return False
        if hashlib.sha256(data).hexdigest() != file.sha256:
            raise StorageError(f"{self._folder.address(file.key)}: is damaged, delete it.", lasting=True)
        path = into / file.name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            sweep(path.parent, path.name)
            with replacing(path) as temporary:
                temporary.write_bytes(data)
        except OSError as error:
            raise StorageError(f"{path}: could not be written ({error.strerror or error}).") from error
        return True

    def _versions(self, prefix: str) -> list[SharedFile]:
        found = [(_KEPT.fullmatch(key), size) for key, size in self._folder.sizes(prefix).items()]
        files = [SharedFile(m["name"], size, m["sha256"], int(m["version"])) for m, size in found if m]
        return [file for file in files if is_plain(file.name)]


def _newest(versions: list[SharedFile]) -> dict[str, SharedFile]:
    return {file.name: file for file in sorted(versions, key=lambda file: (file.version, file.sha256))}


def _common(names: list[str]) -> str:
    """Return the folder that all names share, with a trailing slash. Only this folder is listed."""
    parts = [name.split("/")[:-1] for name in names]
    shared = []
    for level in zip(*parts, strict=False):
        if len(set(level)) > 1:
            break
        shared.append(level[0])
    return "".join(f"{part}/" for part in shared)


def _read(folder: Path, name: str) -> bytes:
    if not is_plain(name):
        raise StorageError(f"{name!r:.200}: is not a path within a folder.", lasting=True)
    try:
        return (folder / name).read_bytes()
    except OSError as error:
        raise StorageError(f"{folder / name}: cannot be read ({error.strerror or error}).", lasting=True) from error


def _is_here(folder: Path, file: SharedFile) -> bool:
    path = folder / file.name
    try:
        if path.stat().st_size != file.bytes:
            return False
        with open(path, "rb") as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest() == file.sha256
    except FileNotFoundError:
        return False
    except OSError as error:
        raise StorageError(f"{path}: cannot be read ({error.strerror or error}).") from error
