"""Exchange of checkpoints between machines without a common disk: each copies the files that it needs from and to an address."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from splatreel.base.errors import StorageError
from splatreel.base.untrusted import open_regular
from splatreel.run.jobs import chapter_name
from splatreel.run.run_logs import LOGS
from splatreel.run.store import LAST_OF_GROUP, REEL_FILES_OF_GROUP, Store
from splatreel.scene.group import ChapterSpan
from splatreel.storage.address import Address, log_retry
from splatreel.storage.transport import is_plain

_KEPT = re.compile(r"(?P<name>.+)@(?P<version>[0-9]{6})-(?P<sha256>[0-9a-f]{64})", re.DOTALL)
_EACH = 2
"""Up to this many files at the top level are looked up by name; for more, the whole folder is listed."""
_LISTINGS = 3
"""Attempts to fetch files that are replaced during the fetch."""
_OF_GROUP = re.compile(r"(group[0-9]{4,})/(\w[\w.-]*)")


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
    """Folder at any address, for files that machines push and pull.

    The stored name contains the version and the digest of a file. One listing therefore shows all changes, no reader
    finds a partial file, and versions need no clock. Any number of machines may push at a time if no two of them push a
    file of the same name.

    All methods raise `StorageError` if the address cannot be reached.
    """

    def __init__(self, address: Address) -> None:
        self._address = address
        self._known: dict[str, list[SharedFile]] = {}
        """Versions of files that this process pushed. No other process pushes them, so they are not listed again."""

    def files(self, prefix: str = "") -> dict[str, SharedFile]:
        """Return the newest version of each file whose name starts with `prefix`."""
        return _newest(self._versions(prefix))

    def push(self, folder: Path, names: Iterable[str]) -> list[str]:
        """Upload the changed ones of some files, given by their paths within a folder, in this order. Return their names.

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
                self._address.write(there.key, data)
                sent.append(name)
            for old in versions:
                if old != there:
                    self._address.remove(old.key)
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
        """Download files in the given order, except those that are already present. Return the names of the downloaded ones, sorted.

        `listed` is a recent result of `files`; None lists the folder.

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
                    f"{self._address}: has no file {missing[0]!r:.200}. Has the job that writes it finished?"
                )
            wanted = sorted(files) if names is None else names
            left = [files[name] for name in wanted if not _is_here(into, files[name])]
            found = [file.name for file in left if self._fetch(file, into)]
            fetched += found
            if len(found) == len(left):
                return sorted(set(fetched))
        raise StorageError(f"{self._address}: files there change faster than they can be fetched. Try again later.")

    def _fetch(self, file: SharedFile, into: Path) -> bool:
        """Download one file. Return False if it was replaced since the listing."""
        data = self._address.read(file.key, file.bytes + 1)
        if data is None:
            return False
        if hashlib.sha256(data).hexdigest() != file.sha256:
            raise StorageError(f"{self._address.name(file.key)}: is damaged, delete it.", lasting=True)
        Address(into).write(file.name, data)
        return True

    def _versions(self, prefix: str) -> list[SharedFile]:
        found = [(_KEPT.fullmatch(key), size) for key, size in self._address.sizes(prefix).items()]
        files = [SharedFile(m["name"], size, m["sha256"], int(m["version"])) for m, size in found if m]
        return [file for file in files if is_plain(file.name)]


class _SameFolder(SharedFolder):
    """Folder that all machines have, so that nothing is ever missing there or here."""

    def __init__(self) -> None:
        pass

    def push(self, folder: Path, names: Iterable[str]) -> list[str]:
        """Send nothing."""
        return []

    def files(self, prefix: str = "") -> dict[str, SharedFile]:
        """Return that nothing has to be fetched."""
        return {}


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
        with open_regular(folder / name, StorageError) as file:
            return file.read()
    except OSError as error:
        raise StorageError(f"{folder / name}: cannot be read ({error.strerror or error}).", lasting=True) from error


def _is_here(folder: Path, file: SharedFile) -> bool:
    path = folder / file.name
    try:
        if path.stat().st_size != file.bytes:
            return False
        with open_regular(path, StorageError) as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest() == file.sha256
    except FileNotFoundError:
        return False
    except OSError as error:
        raise StorageError(f"{path}: cannot be read ({error.strerror or error}).") from error


class Exchange:
    """Copies files between OUT/work on this machine and the same folder at an address (`SharedFolder`).

    All methods raise `StorageError` where the address cannot be reached.

    Args:
        url: Address of OUT there; None if all machines have the same folder OUT. Nothing is copied then.
        out: Folder OUT on this machine.
        report: Called with the reason of each retry.
    """

    def __init__(self, url: str | None, out: Path, report: Callable[[str], None] = log_retry) -> None:
        self._shared: SharedFolder = _SameFolder()
        if url is not None:
            self._shared = SharedFolder(Address(f"{url.rstrip('/')}/work", report=report, writes=True))
        self._work = out / "work"

    def fetch_scene(self) -> None:
        """Fetch all files that do not belong to one group, except logs."""
        there = self._shared.files()
        names = [name for name in there if not _OF_GROUP.fullmatch(name) and not name.startswith(f"{LOGS}/")]
        self._shared.pull(names, self._work, there)

    def send_scene(self) -> None:
        """Send the files that the scene's job has made."""
        seconds = {f"{path.name}" for path in self._work.glob("seconds-chapter*")}
        top = [path.name for path in self._work.iterdir() if path.is_file() and path.name not in seconds]
        scene = [f"scene/{path.name}" for path in (self._work / "scene").iterdir()]
        self._send([*sorted(scene), *sorted(top)])

    def send_tables(self) -> None:
        """Send the frame tables of the capture, if there are any."""
        self._send([path.name for path in [Store(self._work).tables_file] if path.exists()])

    def fetch_chapter(self, chapter: ChapterSpan) -> None:
        """Fetch all files of a chapter's groups."""
        self._shared.pull_all(f"{LOGS}/{chapter_name(chapter.index)}.log", self._work)
        for span in chapter.groups:
            self._shared.pull_all(f"{self._group(span.index)}/", self._work)

    def send_log(self, part: str) -> None:
        """Send the log of a job, if there is one."""
        name = f"{LOGS}/{part}.log"
        self._send([name] if (self._work / name).exists() else [])

    def send_group(self, chapter: int, group: int) -> None:
        """Send all files of a group. The file that marks it as finished comes last."""
        folder = self._group(group)
        names = sorted(path.name for path in (self._work / folder).iterdir())
        names.sort(key=lambda name: name == LAST_OF_GROUP)
        self._send([f"seconds-{chapter_name(chapter)}.json", *(f"{folder}/{name}" for name in names)])

    def fetch_finished(self, groups: Iterable[int] | None = None) -> None:
        """Fetch the files of finished groups that a reel is written from. `groups` names them; None fetches all finished ones."""
        if groups is None:
            there = self._shared.files("group")
            found = [_OF_GROUP.fullmatch(name) for name in there]
            folders = {match[1] for match in found if match and match[2] == LAST_OF_GROUP}
        else:
            folders = {self._group(group) for group in groups}
            there = {name: file for folder in folders for name, file in self._shared.files(f"{folder}/").items()}
        for folder in sorted(folders):
            names = (f"{folder}/{name}" for name in REEL_FILES_OF_GROUP)
            self._shared.pull([name for name in names if name in there], self._work, there)

    def _group(self, index: int) -> str:
        return f"group{index:04d}"

    def _send(self, names: list[str]) -> None:
        """Send files, except locks and files that are half written."""
        self._shared.push(self._work, [name for name in names if not Path(name).name.startswith(".")])
