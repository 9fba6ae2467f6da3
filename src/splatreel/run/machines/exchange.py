"""Exchange of checkpoints between machines without a common disk: each copies the files that it needs from and to a shared folder."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from splatreel.run.job_log import LOGS
from splatreel.run.jobs import chapter_name
from splatreel.run.store import LAST_OF_GROUP, REEL_FILES_OF_GROUP, Store
from splatreel.scene.spans import ChapterSpan
from splatreel.storage.retrying import ignore_message
from splatreel.storage.shared_folder import SharedFolder

_OF_GROUP = re.compile(r"(group[0-9]{4,})/(\w[\w.-]*)")


class Exchange:
    """Copies files between OUT/work on this machine and the same folder at an address (`SharedFolder`).

    All methods raise `StorageError` where the address cannot be reached.

    Args:
        url: Address of OUT there.
        out: Folder OUT on this machine.
        tell: Receives messages about retries.
    """

    def __init__(self, url: str, out: Path, tell: Callable[[str], None] = ignore_message) -> None:
        """Remember both folders."""
        self._shared = SharedFolder(f"{url.rstrip('/')}/work", tell)
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
