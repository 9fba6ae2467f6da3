"""Rate and distortion: one reconstruction encoded in many ways, each decoded again and compared with cameras held out."""

from __future__ import annotations

import dataclasses
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.capture.base import Capture
from splatreel.codec.info import reel_info
from splatreel.codec.reader import ReelReader
from splatreel.config import EncodeConfig
from splatreel.errors import UsageError
from splatreel.evaluation.evaluate import check_same_capture, choose_cameras, choose_frames, read_frames
from splatreel.evaluation.metrics import psnr
from splatreel.evaluation.undecoded import undecoded_frames
from splatreel.kernels.image import render_image
from splatreel.play.timeline import Timeline
from splatreel.progress import Progress, Silent
from splatreel.recon.publish import encode

PAPER = EncodeConfig(codec="h265")
CONFIGURATIONS: dict[str, EncodeConfig] = {
    "paper": PAPER,
    "paper, scales 8 bits (Table 9)": dataclasses.replace(PAPER, scale_bits=8),
    "paper, codebook 256 (Table 9)": dataclasses.replace(PAPER, sh_entries=256),
    "paper, no SH (Table 9)": dataclasses.replace(PAPER, sh_entries=0),
    "paper, CRF 14 (Table 10)": dataclasses.replace(PAPER, crf=14),
    "paper, CRF 28 (Table 10)": dataclasses.replace(PAPER, crf=28),
    "paper, QP_DRC 14 (Table 10)": dataclasses.replace(PAPER, position_bits=14),
    "predictive 0.3 (--rate high)": EncodeConfig(coarseness=0.3),
    "predictive 0.6 (--rate medium)": EncodeConfig(),
    "predictive 0.8": EncodeConfig(coarseness=0.8),
    "predictive 1.2 (--rate low)": EncodeConfig(coarseness=1.2),
    "predictive 2": EncodeConfig(coarseness=2.0),
    "predictive 4": EncodeConfig(coarseness=4.0),
}
MOTION = ("offsets", "dx", "dq")


@dataclass(frozen=True)
class Row:
    """One way to encode. loss: dB below the PSNR before encoding. sections: bytes by kind of file and section."""

    name: str
    bytes: int
    offset_bytes: int
    psnr: float
    loss: float
    sections: dict[str, dict[str, int]]


def rate_distortion(
    run: Path, capture: Capture, *, every: int = 4, names: list[str] | None = None, progress: Progress | None = None
) -> list[Row]:
    """Encode the checkpoints of a run in all ways of CONFIGURATIONS, or those named, and measure each.

    every: of the frames, every how many are rendered. Raises what encoding and reading raise, `UsageError` for an unknown name.
    """
    unknown = set(names or []) - set(CONFIGURATIONS)
    if unknown:
        raise UsageError(f"No configuration is called {min(unknown)!r}. Known are {', '.join(CONFIGURATIONS)}.")
    work, progress = run / "work", progress or Silent()
    reader = ReelReader(run / "reel")
    check_same_capture(reader.manifest, capture, str(run))
    views = choose_cameras(capture, None)
    chosen = choose_frames(min(capture.frames, reader.frames), None)[::every]
    truths = [truth.copy() for _, truth in read_frames(capture, chosen, [view.name for view in views])]

    def score(at) -> float:
        values = []
        for frame, images in zip(chosen, truths, strict=True):
            gaussians = at(frame)
            for view, truth in zip(views, images, strict=True):
                image = render_image(gaussians, view, near=reader.manifest.near)
                values.append(psnr(np.clip(image, 0, 1), truth))
        return float(np.mean(values))

    before = score(undecoded_frames(work, run / "reel"))
    rows = []
    for name in names or CONFIGURATIONS:
        with tempfile.TemporaryDirectory(prefix="splatreel-rates-") as folder:
            encode(work, Path(folder), CONFIGURATIONS[name], progress)
            info, timeline = reel_info(folder), Timeline(ReelReader(folder))
            after = score(lambda frame, timeline=timeline: timeline.at(frame / timeline.fps))
        offsets = sum(info.section_bytes["group"].get(section, 0) for section in MOTION)
        rows.append(Row(name, info.bytes, offsets, after, before - after, info.section_bytes))
    return rows


def bytes_at(rows: list[Row], loss: float) -> float | None:
    """Bytes that the configurations in rows have at a loss, in between by the logarithm; None outside of what they cover."""
    points = sorted((row.loss, np.log(row.bytes)) for row in rows)
    losses = [point[0] for point in points]
    if not points or not losses[0] <= loss <= losses[-1]:
        return None
    return float(np.exp(np.interp(loss, losses, [point[1] for point in points])))


def table(rows: list[Row]) -> str:
    """The rows as Markdown, and what ours takes at the paper's quality."""
    paper = next((row for row in rows if row.name == "paper"), rows[0])
    lines = ["| configuration | MB | of the first | offsets MB | PSNR dB | loss dB |", "|---|---|---|---|---|---|"]
    for row in rows:
        lines.append(
            f"| {row.name} | {row.bytes / 1e6:.3f} | {row.bytes / paper.bytes:.1%} | {row.offset_bytes / 1e6:.3f} | "
            f"{row.psnr:.2f} | {row.loss:.3f} |"
        )
    ours = [row for row in rows if row.name.startswith("predictive")]
    for slack in (0.0, 0.02):
        found = bytes_at(ours, paper.loss + slack)
        if found is not None:
            lines.append(
                f"\nAt the paper's loss + {slack:g} dB: predictive takes {found / paper.bytes:.1%} of its bytes."
            )
    return "\n".join(lines) + "\n"
