"""Everything that a report page shows, read from the folders of a run and of its evaluation."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.errors import SplatreelError
from splatreel.base.untrusted import read_json
from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.config import preset
from splatreel.config.presets import Quality
from splatreel.config.settings import complete_settings
from splatreel.evaluation.reel_capture import work_of
from splatreel.evaluation.report import Report
from splatreel.run.run_folder import FILE, differences
from splatreel.run.run_logs import RunHistory, read_history
from splatreel.run.store import Store
from splatreel.scene.camera import Camera

PRESETS: tuple[Quality, ...] = ("draft", "standard", "paper")


@dataclass(frozen=True)
class GroupFacts:
    """Numbers of one group.

    Attributes:
        end: Frame after the last.
        static: Static points of the layers that live at it.
        born: Static points that were born at it.
        dynamic: Dynamic points.
        bytes: Bytes of the group and of the layers that were born at it.
        seconds: Seconds of its reconstruction; None if unknown.
        psnr: Mean PSNR of its own frames, dB; None if not evaluated.
    """

    index: int
    first: int
    end: int
    static: int
    born: int
    dynamic: int
    bytes: int
    seconds: float | None
    psnr: float | None


def group_facts(manifest: Manifest, seconds: Mapping[int, float], psnr: Mapping[int, float]) -> list[GroupFacts]:
    """Return the numbers of each group of a manifest.

    Args:
        manifest: Manifest of a reel.
        seconds: Seconds by group, as far as they are known.
        psnr: PSNR by frame, dB; empty before an evaluation.
    """
    ends = [entry.first_frame for entry in manifest.groups[1:]] + [manifest.frames]
    found = []
    for entry, end in zip(manifest.groups, ends, strict=True):
        born = [layer for layer in manifest.layers if layer.group == entry.group]
        own = [value for frame, value in psnr.items() if entry.first_frame <= frame < end]
        found.append(
            GroupFacts(
                index=entry.group,
                first=entry.first_frame,
                end=end,
                static=manifest.static_points(entry.group),
                born=sum(layer.points for layer in born),
                dynamic=entry.points,
                bytes=entry.bytes + sum(layer.bytes for layer in born),
                seconds=seconds.get(entry.group),
                psnr=sum(own) / len(own) if own else None,
            )
        )
    return found


@dataclass(frozen=True)
class RunFacts:
    """A run, its reel and its evaluation.

    Attributes:
        reel: Location of the reel.
        points: Some static points of the first group, [N, 3].
        report: Report of the evaluation; None before it.
        images: Folder of the images.
        history: History of the run; empty for a reel without its run.
        record: Content of run.json; empty for a reel without its run.
        coverage: Sentences about the coverage of the cameras.
        seconds: Seconds of each stage, of the run and of its evaluation.
    """

    reel: str
    manifest: Manifest
    points: np.ndarray
    report: Report | None
    images: Path
    history: RunHistory
    record: Mapping[str, Any]
    coverage: list[str]
    seconds: Mapping[str, float]

    @staticmethod
    def read(out: Path, reel: str | Path, most: int | None = None) -> RunFacts:
        """Read the facts of a reel. A report or a run of another version counts as missing.

        Args:
            out: Folder of report.json and images.
            reel: Folder or URL of the reel; the run is in `work` beside the folder.
            most: Memory in bytes that decoding a file may take, see `ReelReader`.

        Raises:
            ReelError: There is no reel.
        """
        reader = ReelReader(reel, most=most)
        groups, work = reader.manifest.groups, work_of(reel, reader.manifest)
        points = reader.static(groups[0].group)[0].means if groups else np.zeros((0, 3), np.float32)
        report = record = coverage = seconds = None
        if (out / "report.json").exists():
            report = _or_none(lambda: Report.read(out / "report.json"))
        if work is not None:
            record = _or_none(lambda: read_json(work / FILE, SplatreelError)) if (work / FILE).exists() else None
            coverage = _or_none(lambda: Store(work).coverage())
            seconds = _or_none(lambda: Store(work).seconds())
        return RunFacts(
            reel=str(reel),
            manifest=reader.manifest,
            points=points,
            report=report,
            images=out / "pictures",
            history=RunHistory() if work is None else read_history(work),
            record=record if isinstance(record, dict) else {},
            coverage=report.coverage if report and report.coverage else coverage.sentences() if coverage else [],
            seconds={**(seconds or {}), **(report.seconds if report else {})},
        )

    @property
    def held_out(self) -> list[Camera]:
        """Cameras that were compared with and did not train."""
        cameras = self.report.cameras if self.report else []
        trained = {camera.name for camera in self.manifest.cameras}
        return [Camera.from_dict(c["camera"]) for c in cameras if c["name"] not in trained and "camera" in c]

    def groups(self) -> list[GroupFacts]:
        """Return the numbers of each group."""
        psnr = {frame["frame"]: frame["psnr"] for frame in self.report.per_frame} if self.report else {}
        return group_facts(self.manifest, self.history.group_seconds(), psnr)

    def quality(self) -> str:
        """Return the preset of the run and the settings that differ from it; empty if unknown."""
        recorded = self.record.get("config")
        if not recorded:
            return ""
        config = complete_settings(recorded)
        ignored = {"seed", "chapter_frames", "training_megapixels"}  # seed is shown, a record may clear the others
        mine = {name: value for name, value in config.items() if name not in ignored}
        found: dict[str, list[str]] = {}  # names of the settings that differ, by preset
        for name in PRESETS:
            theirs = json.loads(preset(name).to_json())
            texts = differences({k: v for k, v in theirs.items() if k not in ignored}, mine)
            found[name] = [text.split(" ")[0] for text in texts]
        nearest = min(found, key=lambda name: len(found[name]))
        changes = f", except {', '.join(found[nearest])}" if found[nearest] else ""
        return f"{nearest}{changes}, seed {config.get('seed')}"


def _or_none(read: Any) -> Any:
    try:
        return read()
    except SplatreelError:
        return None
