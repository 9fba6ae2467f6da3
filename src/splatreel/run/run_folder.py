"""The output folder of a run: the record of its capture and settings, and locks.

A run is continued only if capture and settings are the same. One process at a time writes a folder, or a part of it, and for one run
only.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from splatreel.base.atomic import lock, open_lock, sweep
from splatreel.base.errors import InUseError, ReconstructionError
from splatreel.base.new_folder import created
from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.config.settings import complete_settings
from splatreel.run.store import load_json, save_json
from splatreel.scene.group import chapter_spans, group_spans
from splatreel.scene.reel_source import ReelSource, parse_reel_source

VERSION = 1
"""Version of the checkpoints. A new version cannot continue runs of an old one."""
FILE = "run.json"
FINGERPRINT = "fingerprint"
SHOWN = 3
"""Number of differences that an error lists."""


def run_record(capture: Capture, config: Config, sound: str) -> dict[str, Any]:
    """Return everything that decides the result of a run.

    Args:
        capture: The capture.
        config: Settings.
        sound: The soundtrack, as `reconstruct` takes it. Of a file only the name counts: it may have been moved.
    """
    settings = json.loads(config.to_json())
    groups = group_spans(capture.frames, config.group.length, config.group.overlap)
    if len(chapter_spans(groups, config.chapter_frames)) == 1:
        settings["chapter_frames"] = 0  # has no effect on a short video
    if 1e-6 * capture.width * capture.height <= config.training_megapixels:
        settings["training_megapixels"] = 0.0  # has no effect on small images
    return {"version": VERSION, "capture": capture.describe(), "config": settings, "sound": Path(sound).name}


def has_record(work: Path) -> bool:
    """Return True if a folder of checkpoints belongs to a run."""
    return (work / FILE).exists()


def save_record(work: Path, record: dict[str, Any]) -> None:
    """Write the record of a run."""
    save_json(work / FILE, record)


def check_record(work: Path, record: dict[str, Any]) -> None:
    """Compare the record in a folder with that of this run.

    Raises:
        ReconstructionError: They differ. The error lists the differences.
    """
    path = work / FILE
    theirs = load_json(path)
    theirs = theirs if isinstance(theirs, dict) else {}
    found = differences(theirs | {"config": complete_settings(theirs.get("config"))}, record)
    if found:
        more = [f"and {len(found) - SHOWN} more"] if len(found) > SHOWN else []
        raise ReconstructionError(
            f"{path}: this folder holds another reconstruction: {'; '.join([*found[:SHOWN], *more])}. "
            "Choose another --out, ask for the same again, or delete the folder to start over."
        )


def recorded_settings(work: Path) -> Any:
    """Return the settings of a run, nested as `Config.to_json` writes them; None without a run."""
    record = load_json(work / FILE) if has_record(work) else None
    return record.get("config") if isinstance(record, dict) else None


def read_run_source(work: Path) -> ReelSource | None:
    """Return the frames and cameras that a run was made from, for its reels of earlier versions; None if unknown.

    Cameras that were left out are not in the record.
    """
    record = load_json(work / FILE) if has_record(work) else None
    capture, config = (record.get(name) for name in ("capture", "config")) if isinstance(record, dict) else (None, None)
    if not isinstance(capture, dict):
        return None
    region = isinstance(config, dict) and config.get("region")
    part = "masks" if "masks" in capture else "region" if region else None
    first = re.match(r"[0-9]{1,9}(?=:)", str(capture.get("frames")))
    frame = None if first is None else int(first[0])
    return parse_reel_source({"frame": frame, "held_out": capture.get("held_out", []), "part": part})


def differences(theirs: dict[str, Any], mine: dict[str, Any], prefix: str = "") -> list[str]:
    """Return the differences of two nested records, such as `config.seed is 1 there, 0 now`.

    Different fingerprints are listed only if nothing else differs.
    """
    found = []
    for name in sorted({*theirs, *mine} - {FINGERPRINT}):
        a, b = theirs.get(name), mine.get(name)
        if isinstance(a, dict) and isinstance(b, dict):
            found += differences(a, b, f"{prefix}{name}.")
        elif a != b:
            now = json.dumps(b) if name in mine else "not to be set"
            found.append(f"{prefix}{name} is {json.dumps(a):.60} there, {now:.60} now")
    if not found and theirs.get(FINGERPRINT) != mine.get(FINGERPRINT):
        found.append(f"the {prefix.rstrip('.')} has other files or camera poses")
    return found


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
        self.out = out
        self.reel = out / "reel"
        self.work = out / "work"
        self.record = record
        self.part = part
        self.writes = writes
        self._lock: int | None = None

    def __enter__(self) -> RunLock:
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
