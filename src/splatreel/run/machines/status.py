"""`status.json` of a run of several chapters: the progress of each chapter, for people and programs that watch the run."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, replace

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import ReelError, StorageError
from splatreel.run.jobs import ChapteredRun, chapter_name, has_chapter
from splatreel.run.run_logs import read_log
from splatreel.storage.address import Address

STATUS = "status.json"
INTERVAL = 2.0
"""Seconds between two updates of the file, except when a chapter starts or ends."""
PAUSES = (0.5, 1.0)
"""Seconds before retries of the copy elsewhere. There are few, because the file is soon written again."""


@dataclass(frozen=True)
class ChapterStatus:
    """Status of one chapter.

    Attributes:
        groups: First and last group, from 1.
        state: waiting, running, finished or failed.
        done: Share of the chapter that is done, 0..1.
        node: Machine that makes or made it.
        memory: Largest number of bytes that its process held, if known.
        error: Reason of a failure.
    """

    chapter: int
    groups: tuple[int, int]
    state: str = "waiting"
    done: float = 0.0
    node: str | None = None
    attempts: int = 0
    memory: int | None = None
    error: str | None = None


class RunStatus:
    """Writes OUT/status.json, and the same file into the run's folder elsewhere.

    Args:
        run: The run.
        url: Address of the run's folder elsewhere, if any. The run continues if it cannot be reached.
    """

    def __init__(self, run: ChapteredRun, url: str | None = None) -> None:
        self._run = run
        self._last = -INTERVAL
        self._elsewhere = None if url is None else Address(url, pauses=PAUSES, writes=True)
        self.state = "running"
        self.published = 0
        self.chapters = [
            ChapterStatus(chapter.index + 1, (chapter.first, chapter.groups[-1].index + 1)) for chapter in run.chapters
        ]
        self.read_chapters()

    def read_chapters(self) -> None:
        """Read the status of all chapters from checkpoints and logs."""
        for chapter in self._run.chapters:
            found = read_log(self._run.store.work, chapter_name(chapter.index))
            there = has_chapter(self._run, chapter)
            self.change(
                chapter.index,
                state="finished" if there else found.state if found.state != "finished" else "waiting",
                done=1.0 if there else 0.0,
                node=found.node,
                attempts=found.attempts,
                error=None if there else found.error,
            )

    def change(self, chapter: int, **values: object) -> None:
        """Replace fields of a chapter's status."""
        self.chapters[chapter] = replace(self.chapters[chapter], **values)  # pyright: ignore[reportArgumentType]

    def write(self, at_once: bool = True) -> None:
        """Write the file. With `at_once` False it is not written if it was written a moment ago."""
        if not at_once and time.monotonic() - self._last < INTERVAL:
            return
        self._last = time.monotonic()
        done = sum(chapter.done for chapter in self.chapters) / max(len(self.chapters), 1)
        content = {
            "format": "splatreel-status",
            "version": 1,
            "state": self.state,
            "updated": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "done": round(done, 4),
            "groups": len(self._run.groups),
            "published": self.published,
            "chapters": [asdict(chapter) for chapter in self.chapters],
        }
        data = (json.dumps(content, indent=1) + "\n").encode()
        with suppress(ReelError):  # a full disk is reported where checkpoints are written
            write_bytes(self._run.out / STATUS, data)
        if self._elsewhere is not None:
            with suppress(StorageError):
                self._elsewhere.write(STATUS, data)
