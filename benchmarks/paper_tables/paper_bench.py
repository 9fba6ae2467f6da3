"""Reconstructions behind the paper's tables: one per capture and variant, shared by all tables, continued when interrupted."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.frame_methods import AttributeVideo, PerFrame, Streaming
from baselines.independent_groups import run_independent_groups
from baselines.part_by_part import PartMethod, run_in_parts
from baselines.shared_start import SharedStart
from baselines.temporal_slices import TemporalSlices
from splatreel.base.errors import UsageError
from splatreel.base.progress import Progress, format_rounded
from splatreel.capture.base import Capture
from splatreel.codec.inspection import reel_info
from splatreel.config import Config
from splatreel.config.settings import changed
from splatreel.evaluation.evaluate import evaluate, uncompressed_frames
from splatreel.evaluation.report import Report
from splatreel.run.estimate import estimate
from splatreel.run.machine_speed import measure_run_speed
from splatreel.run.machines.local_processes import division_of
from splatreel.run.pipeline import plan_run, reconstruct

FULL = "Full"
NO_LAYERS = "All points move"
VARIANTS: dict[str, dict[str, Any]] = {
    FULL: {},
    "w/o Reg.": {"group.lambda_arap": 0.0, "group.lambda_temporal": 0.0},
    "w/o Prg.": {"group.progressive_share": 0.0},
    "w/o Adp.": {"layering.adapt_every": 0},
    "w/o Rfn.": {"keyframe.refine_iterations": 1},
    **{f"length {length}": {"group.length": length} for length in (10, 20, 30, 40, 50)},
    NO_LAYERS: {"layering.enabled": False},
}
"""Changes of settings of each variant (docs/paper-map.md)."""
INDEPENDENT = "Independent groups"
PER_FRAME, STREAMING, VIDEO, SLICES = "3DGS per frame", "3DGStream-like", "V3-like", "4DGS-like"
METHODS: dict[str, PartMethod] = {
    PER_FRAME: PerFrame(),
    STREAMING: Streaming(),
    VIDEO: AttributeVideo(),
    SLICES: TemporalSlices(),
}
"""Baselines that train as long as `Full` did."""
BASELINES = (*METHODS, INDEPENDENT)
"""Variants that are other methods than ours."""


@dataclass(frozen=True)
class Measured:
    """One reconstruction.

    Attributes:
        report: Its evaluation on the held-out cameras.
        float32_bytes: Size of its points and offsets as float32 numbers.
        run: Its output folder.
    """

    report: Report
    float32_bytes: int
    run: Path

    @property
    def minutes(self) -> float:
        """Minutes of the reconstruction, without evaluation. The encoding of `METHODS` does not count."""
        return sum(value for name, value in self.report.seconds.items() if name != "evaluate") / 60


class PaperBench:
    """Reconstructions of captures in variants.

    Args:
        captures: Captures by name, each with held-out cameras.
        config: Settings of the variant `Full`.
        out: Folder with OUT/CAPTURE/DIGEST, the digest being that of the settings. Variants with equal settings share it.
        device: auto, cpu, gpu or cuda. The baselines of `METHODS` train on the CPU.
        progress: Progress display.
        minutes: Minutes that each baseline of `METHODS` may train, our first keyframe included; None allows as many as the
            variant `Full` took.

    Raises:
        UsageError: A capture has no held-out camera.
    """

    def __init__(
        self,
        captures: Mapping[str, Capture],
        config: Config,
        out: Path,
        device: str,
        progress: Progress,
        minutes: float | None = None,
    ) -> None:
        for capture in captures.values():
            if not capture.held_out:
                raise UsageError(f"{capture.path}: no camera is held out. Name some: --hold-out NAME,NAME.")
        self.captures = dict(captures)
        self.config = config
        self.out = out
        self.device = device
        self.progress = progress
        self.minutes = minutes
        self._measured: dict[Path, Measured] = {}

    def settings(self, variant: str) -> Config:
        """Return the settings of a variant. Those of a baseline are those of `Full`."""
        return changed(self.config, VARIANTS.get(variant, {}))

    def folder(self, capture: str, variant: str) -> Path:
        """Return the output folder of a reconstruction."""
        text = self.settings(variant).to_json()
        if variant in BASELINES:
            text += variant + (f" {self.minutes:g}" if self.minutes and variant in METHODS else "")
        return self.out / capture / hashlib.sha256(text.encode()).hexdigest()[:12]

    def plan(self, variants: Sequence[str]) -> str:
        """Return how long the missing reconstructions take, and how much memory, in lines."""
        folders: dict[Path, tuple[str, str]] = {}
        for name in self.captures:
            for variant in variants:
                folders.setdefault(self.folder(name, variant), (name, variant))
        missing = {folder: key for folder, key in folders.items() if not (folder / "report.json").exists()}
        lines = [f"{len(folders)} reconstructions, of which {len(folders) - len(missing)} are finished."]
        if not missing:
            return lines[0]
        seconds, memory, speed = 0.0, 0, None
        for folder, (name, variant) in missing.items():
            like = NO_LAYERS if variant == INDEPENDENT else variant
            run = plan_run(self.captures[name], folder, self.settings(like), device=self.device)
            speed = measure_run_speed(run.gpu) if speed is None else speed
            found = estimate(run, division_of(run), speed)
            seconds, memory = seconds + found.total, max(memory, found.memory)
            lines.append(f"  {name}, {variant}: about {format_rounded(found.total)}, {found.memory / 1e9:.1f} GB")
        return "\n".join([*lines, f"All: about {format_rounded(seconds)}, at most {memory / 1e9:.1f} GB."])

    def measure(self, capture: str, variant: str) -> Measured:
        """Reconstruct and evaluate, unless that is finished."""
        folder = self.folder(capture, variant)
        if folder not in self._measured:
            if variant in BASELINES:
                self._measured[folder] = self._measure_baseline(capture, variant, folder)
            else:
                self._measured[folder] = self._measure(self.captures[capture], folder, self.settings(variant))
        return self._measured[folder]

    def _measure_baseline(self, name: str, variant: str, folder: Path) -> Measured:
        capture, reel, path = self.captures[name], folder / "reel", folder / "report.json"
        if not path.exists():
            undecoded, device = None, "cpu"
            if variant == INDEPENDENT:
                seconds, device = run_independent_groups(capture, folder, self.config, self.device, self.progress)
                undecoded = uncompressed_frames(folder / "work", reel)
            else:
                full = self.measure(name, FULL)
                if full.report.device != device:
                    self.progress.note(
                        f"{variant} trains on the CPU; {FULL} trained on another device ({full.report.device})."
                    )
                start = SharedStart(capture, full.run, self.config.for_video(capture.frames))
                allowed = start.seconds if self.minutes is None else 60 * self.minutes
                seconds = run_in_parts(METHODS[variant], start, folder, allowed, self.progress)
            shown = {"seconds": seconds, "device": device, "progress": self.progress}
            evaluate(reel, capture, out=folder, undecoded=undecoded, **shown)
        return Measured(Report.read(path), reel_info(reel).float32_bytes, folder)

    def _measure(self, capture: Capture, folder: Path, config: Config) -> Measured:
        result = reconstruct(capture, folder, config, device=self.device, progress=self.progress)
        path = folder / "report.json"
        if not path.exists():
            evaluate(
                result.reel,
                capture,
                out=folder,
                undecoded=uncompressed_frames(result.work, result.reel),
                seconds=result.seconds,
                device=result.device,
                progress=self.progress,
            )
        return Measured(Report.read(path), reel_info(result.reel).float32_bytes, folder)

    def record(self) -> list[str]:
        """Return one JSON line per finished reconstruction: capture, variant, its changes and the report without lists."""
        lines = []
        for name in self.captures:
            for variant, changes in {**VARIANTS, **{baseline: {} for baseline in BASELINES}}.items():
                found = self._measured.get(self.folder(name, variant))
                if found is not None:
                    report = json.loads(found.report.to_json())
                    values = {key: value for key, value in report.items() if not isinstance(value, list)}
                    lines.append(json.dumps({"capture": name, "variant": variant, "changes": changes, **values}))
        return lines
