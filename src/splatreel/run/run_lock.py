"""Locks on output folders: one process at a time writes a folder, or a part of it, and for one run only (`run_record`)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from splatreel.base.atomic import lock, open_lock, sweep
from splatreel.base.errors import InUseError, ReconstructionError
from splatreel.base.new_folder import created
from splatreel.run.run_record import check_record, has_record, save_record


class RunLock:
    """Lock on an output folder, with OUT/work and OUT/reel. Use as a context manager.

    Entering creates the folders, locks them, and removes files that a killed process left half written. It removes only files of
    its own part, since some network file systems do not tell which files are being written. Nothing is overwritten if entering fails.

    Args:
        out: Output folder OUT.
        record: Everything that decides the result of the run (`run_record`).
        part: Part of the run, such as chapter0003. Another process may lock another part. Empty for the reel, and for a run without
            parts.
        writes: Files of the part, as folders and beginnings of names in them; None for all files.

    Raises:
        InUseError: Another process has the lock. Raised by entering.
        ReconstructionError: The folder cannot be written, belongs to another run, or holds a reel without its checkpoints. Raised by
            entering.
    """

    def __init__(
        self,
        out: Path,
        record: dict[str, Any],
        part: str = "",
        writes: Iterable[tuple[Path, str]] | None = None,
    ) -> None:
        """Prepare the lock without taking it."""
        self.out = out
        self.reel = out / "reel"
        self.work = out / "work"
        self.record = record
        self.part = part
        self.writes = writes
        self._lock: int | None = None

    def __enter__(self) -> RunLock:
        """Take the lock."""
        self._lock = self._acquire()
        try:
            self._check()
        except BaseException:
            self._release()
            raise
        for folder, name in self._everything() if self.writes is None else self.writes:
            sweep(folder, name)
        return self

    def __exit__(self, *_: object) -> None:
        """Release the lock."""
        self._release()

    def save_record(self) -> None:
        """Write which run the folder belongs to. Called when the first checkpoint is about to be written."""
        save_record(self.work, self.record)

    def _everything(self) -> Iterator[tuple[Path, str]]:
        for root in (self.work, self.reel):
            yield from ((folder, "") for folder in (root, *(place for place in root.rglob("*") if place.is_dir())))

    def _check(self) -> None:
        if has_record(self.work):
            check_record(self.work, self.record)
        elif (self.reel / "manifest.json").exists():
            raise ReconstructionError(
                f"{self.reel}: holds a reel already, but {self.work} has no checkpoints it could be continued from. "
                "Choose another --out, or move the reel away."
            )

    def _acquire(self) -> int:
        try:
            self.work.mkdir(parents=True, exist_ok=True)
            self.reel.mkdir(exist_ok=True)
            handle = os.open(self.work / f".lock{self.part and f'-{self.part}'}", os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise ReconstructionError(
                f"{error.filename}: cannot be written ({error.strerror}). Choose another --out, or remove the obstacle."
            ) from error
        if not lock(handle):
            os.close(handle)
            what = f"making {self.part} of the run in this folder" if self.part else "reconstructing into this folder"
            raise InUseError(f"{self.out}: another process is {what}. Wait for it or choose another --out.")
        return handle

    def _release(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


@contextmanager
def lock_reel(reel: Path) -> Iterator[None]:
    """Lock the folder of a reel that does not belong to a run. Entering creates it, and removes files that a killed process left.

    If the block fails before it wrote a file, the folder is deleted again.

    Raises:
        InUseError: Another process writes the reel.
    """
    with created(reel):
        handle = open_lock(reel)
        try:
            if not lock(handle):
                raise InUseError(f"{reel}: another process is writing this reel. Wait for it or choose another --out.")
            for folder in (reel, *(place for place in reel.iterdir() if place.is_dir())):
                sweep(folder)
            yield
        finally:
            os.close(handle)
