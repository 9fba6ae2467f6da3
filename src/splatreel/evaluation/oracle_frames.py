"""The frames in oracle.json that are finished, so that the same command continues a measurement that was killed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.config.records import complete_settings
from splatreel.errors import UsageError
from splatreel.evaluation.oracle_report import SingleFrame
from splatreel.recon.run import checkpoint
from splatreel.recon.run.run_record import differences

VERSION = 1
"""Raised when frames of before cannot be compared with new ones."""
DECIDING = ("keyframe", "encode", "correct_colors", "seed")
"""The fields of `Config` that a single frame depends on."""


class OracleFrames:
    """The finished frames of one capture and configuration, in a file that is replaced whenever one is added.

    Raises `UsageError` where the file holds those of another, `ReconstructionError` where it cannot be read.
    """

    def __init__(self, path: Path, capture: Capture, config: Config) -> None:
        decide = json.loads(config.to_json())
        self.path = path
        self.record: dict[str, Any] = {
            "version": VERSION,
            "capture": capture.describe(),
            "config": {name: decide[name] for name in DECIDING},
        }
        self.frames: dict[int, SingleFrame] = self._load() if path.exists() else {}

    def _load(self) -> dict[int, SingleFrame]:
        found = checkpoint.load_json(self.path)
        theirs: dict[str, Any] = found if isinstance(found, dict) else {}
        settings = complete_settings(theirs.get("config"))
        theirs = theirs | {"config": {name: settings.get(name) for name in DECIDING}}
        others = differences({name: theirs.get(name) for name in self.record}, self.record)
        if others:
            raise UsageError(
                f"{self.path}: holds frames of another capture or configuration: {'; '.join(others[:3])}. "
                "Choose another --out, ask for the same again, or delete the file to start over."
            )
        try:
            return {frame["frame"]: SingleFrame.from_dict(frame) for frame in theirs["frames"]}
        except (KeyError, TypeError, AttributeError) as error:
            raise UsageError(f"{self.path}: is damaged ({error!r}). Delete it to start over.") from error

    def add(self, frame: SingleFrame) -> None:
        self.frames[frame.frame] = frame
        self.save(None)

    def save(self, reel: dict[str, Any] | None) -> None:
        frames = [dataclasses.asdict(self.frames[number]) for number in sorted(self.frames)]
        checkpoint.save_json(self.path, self.record | {"frames": frames, "reel": reel})
