"""What an output folder belongs to, one capture and one configuration: OUT/work/run.json, compared when a run is continued."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.config.records import updated
from splatreel.errors import ReconstructionError
from splatreel.recon.run import checkpoint
from splatreel.scene.spans import chapter_spans, group_spans

VERSION = 1
"""Raised when checkpoints of before can no longer be continued."""
FILE = "run.json"
FINGERPRINT = "fingerprint"
SHOWN = 3
"""Differences that a message lists."""


def run_record(capture: Capture, config: Config, sound: str) -> dict[str, Any]:
    """All that decides what a run makes. sound: as in `reconstruct`."""
    name = Path(sound).name  # a file may be elsewhere the next time
    settings = json.loads(config.to_json())
    groups = group_spans(capture.frames, config.group.length, config.group.overlap)
    if len(chapter_spans(groups, config.chapter_frames)) == 1:
        settings["chapter_frames"] = 0  # of a short video it decides nothing
    if 1e-6 * capture.width * capture.height <= config.training_megapixels:
        settings["training_megapixels"] = 0.0  # nor this of small images
    return {"version": VERSION, "capture": capture.describe(), "config": settings, "sound": name}


def has_record(work: Path) -> bool:
    return (work / FILE).exists()


def save_record(work: Path, record: dict[str, Any]) -> None:
    checkpoint.save_json(work / FILE, record)


def check_record(work: Path, record: dict[str, Any]) -> None:
    """Raises `ReconstructionError` if the folder's record, which may be of an earlier version, says something else than this one."""
    path = work / FILE
    theirs = checkpoint.load_json(path)
    theirs = {"sound": "auto"} | (theirs if isinstance(theirs, dict) else {})
    found = differences(theirs | {"config": updated(theirs.get("config"))}, record)
    if found:
        more = [f"and {len(found) - SHOWN} more"] if len(found) > SHOWN else []
        raise ReconstructionError(
            f"{path}: this folder holds another reconstruction: {'; '.join([*found[:SHOWN], *more])}. "
            "Choose another --out, ask for the same again, or delete the folder to start over."
        )


def differences(theirs: dict[str, Any], mine: dict[str, Any], prefix: str = "") -> list[str]:
    """What two nested records say differently, such as `config.seed is 1 there, 0 now`; the fingerprint only if nothing else."""
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
