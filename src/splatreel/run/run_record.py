"""OUT/work/run.json: the capture and the settings of a run. A run is continued only if they are the same."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from splatreel.base.errors import ReconstructionError
from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.config.settings import complete_settings
from splatreel.run import checkpoint
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
    checkpoint.save_json(work / FILE, record)


def check_record(work: Path, record: dict[str, Any]) -> None:
    """Compare the record in a folder with that of this run.

    Raises:
        ReconstructionError: They differ. The error lists the differences.
    """
    path = work / FILE
    theirs = checkpoint.load_json(path)
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
    record = checkpoint.load_json(work / FILE) if has_record(work) else None
    return record.get("config") if isinstance(record, dict) else None


def read_run_source(work: Path) -> ReelSource | None:
    """Return the frames and cameras that a run was made from, for its reels of earlier versions; None if unknown.

    Cameras that were left out are not in the record.
    """
    record = checkpoint.load_json(work / FILE) if has_record(work) else None
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
