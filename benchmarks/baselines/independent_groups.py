"""Baseline of independent groups, as in STG: every group is reconstructed alone, without layers, and the groups are chained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from splatreel.base.progress import Progress
from splatreel.capture.base import Capture
from splatreel.config import Config
from splatreel.config.settings import changed
from splatreel.run.output.group_writer import open_writer
from splatreel.run.pipeline import reconstruct
from splatreel.run.store import Store
from splatreel.scene.group import GroupSpan, group_spans
from splatreel.scene.reel_source import ReelSource


class Stretch(Capture):
    """Some consecutive frames of a capture, as a capture of their own. The caller closes the source."""

    def __init__(self, source: Capture, span: GroupSpan) -> None:
        self.source = source
        self.span = span
        super().__init__(
            source.path,
            source.cameras,
            held_out=source.held_out,
            frame_range=(span.first, span.first + span.count),
            fps=source.fps,
            points=source.points if span.first == 0 else None,
            point_colors=source.point_colors if span.first == 0 else None,
            near=source.near,
        )

    def sources(self) -> list[Path]:
        """Return the files that are read."""
        return self.source.sources()

    def reel_source(self) -> ReelSource | None:
        """Return what a reel of these frames says about the whole capture."""
        source = self.source.reel_source()
        return source and replace(source, frame=self.source.first_frame + self.span.first)

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        self.source.read_into(out, first, cameras)

    def _missing(self, first: int, count: int, name: str) -> np.ndarray:
        return self.source.missing(first, count, [name])[:, 0]


def run_independent_groups(
    capture: Capture, out: Path, config: Config, device: str, progress: Progress
) -> tuple[dict[str, float], str]:
    """Reconstruct each group of a capture alone, with all points moving, and write OUT/reel. The same call continues.

    OUT/work gets the groups as trained.

    What it is: config. 1 of the paper's Table 8, "directly chaining independent GOGs", and the division of the video as in
    STG. Cameras, losses, motion and codec are ours. Each group trains as many iterations as a first group of ours.

    What it is not: STG's points with polynomial motion and temporal opacity, and its features.

    Args:
        capture: The capture.
        out: Output folder.
        config: Settings.
        device: auto, cpu, gpu or cuda.
        progress: Progress display.

    Returns:
        Seconds by stage, summed over the groups, and the device that trained: cpu, gpu or cuda.
    """
    spans = group_spans(capture.frames, config.group.length, config.group.overlap)
    seconds: dict[str, float] = {}
    trained = ""
    for span in spans:
        alone = {"group.length": span.count, "group.overlap": 0, "layering.enabled": False, "check_coverage": False}
        settings = changed(config, {**alone, "chapter_frames": 0})
        result = reconstruct(
            Stretch(capture, span), out / f"group{span.index:04d}", settings, device=device, progress=progress
        )
        trained = result.device
        for stage, value in result.seconds.items():
            seconds[stage] = round(seconds.get(stage, 0.0) + value, 3)
    stores = [Store(out / f"group{span.index:04d}" / "work") for span in spans]
    chained = Store(out / "work")
    header, limits = stores[0].header()
    group = config.group
    chained.save_header(replace(header, group_length=group.length, overlap=group.overlap), limits)
    writer = open_writer(chained, out / "reel", config.encode, resume=False)
    for span, store in zip(spans, stores, strict=True):
        stored = store.group(0).group()
        moved = replace(stored.group, index=span.index, first_frame=span.first)
        writer.add_group(moved, encoded=writer.encoder.group(moved, stored.importance, stored.steps))
        chained.group(span.index).save_group(replace(stored, group=moved))
    writer.finish()
    chained.save_seconds(seconds)
    return seconds, trained
