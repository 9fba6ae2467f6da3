"""Record of the command that made a calibration, in the folder of its model.

A command that was killed just after it finished finds its own model when it runs again. COLMAP does not give the same model twice,
so the record is compared, and not the model.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from splatreel.base.errors import CaptureError, SplatreelError
from splatreel.base.untrusted import read_file, read_json
from splatreel.calibration.uncalibrated import MODEL
from splatreel.capture.image_sequences import IMAGE_SUFFIXES
from splatreel.capture.sidecar import read_sidecar
from splatreel.capture.video import VIDEO_SUFFIXES

RECORD = "calibration.json"
"""File beside those of COLMAP, which ignores it."""
METRIC = ("distance", "scale_board", "board")
"""Options with which the unit of a calibration is a meter."""
MODEL_BYTES = 1 << 30
"""Maximum size of a file of a model that is compared with its record."""


def calibration_record(path: Path, options: dict[str, Any], others: list[Path]) -> dict[str, Any]:
    """Return what determines a calibration: options, the start times, and the names and lengths of the files.

    Args:
        path: Folder of the capture.
        options: Options of the command.
        others: Other folders that it reads, of photographs or of videos.
    """
    sidecar = read_sidecar(path)
    lengths = [{str(file): size for file, size in _camera_files(folder)} for folder in (path, *others)]
    return {"options": options, "starts": sidecar.starts, "rates": sidecar.rates, "files": lengths}


def _camera_files(folder: Path) -> Iterator[tuple[Path, int]]:
    """Yield the videos and images below a folder, and their lengths in bytes."""
    for file in sorted(folder.rglob("*")):
        if file.suffix.lower() in (*VIDEO_SUFFIXES, *IMAGE_SUFFIXES) and file.is_file():
            yield file.relative_to(folder), file.stat().st_size


def write_record(model: Path, record: dict[str, Any]) -> None:
    """Write the record of a model into its folder."""
    (model / RECORD).write_text(json.dumps(record | {"model": _digests(model)}, indent=1) + "\n", encoding="utf-8")


def is_made_by(path: Path, record: dict[str, Any]) -> bool:
    """Return whether a capture has a whole model that a command with the same record made."""
    model = path / MODEL
    try:
        known = read_json(model / RECORD, CaptureError)
        return isinstance(known, dict) and known == record | {"model": _digests(model)}
    except (SplatreelError, OSError):
        return False


def is_in_meters(path: Path) -> bool:
    """Return whether a capture has a whole model that `capture calibrate` made, whose unit is a meter."""
    model = path / MODEL
    try:
        known = read_json(model / RECORD, CaptureError)
        options = known.get("options") if isinstance(known, dict) else None
        return isinstance(options, dict) and any(o in options for o in METRIC) and known.get("model") == _digests(model)
    except (SplatreelError, OSError):
        return False


def _digests(model: Path) -> dict[str, str]:
    files = sorted(file for file in model.iterdir() if file.is_file() and file.name != RECORD)
    return {file.name: hashlib.sha256(read_file(file, MODEL_BYTES, CaptureError)).hexdigest() for file in files}
