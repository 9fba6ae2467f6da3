"""Rate and distortion: one reconstruction encoded in many ways, each decoded and compared with held-out cameras."""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from bench.provenance import check_unseen
from splatreel.base.errors import UsageError
from splatreel.base.progress import Progress, Silent
from splatreel.base.untrusted import JSON_BYTES, parse_json, read_file
from splatreel.capture.base import Capture
from splatreel.codec.inspection import MOTION, reel_info
from splatreel.codec.reader import ReelReader
from splatreel.config import COARSENESS, EncodeConfig
from splatreel.evaluation.evaluate import (
    check_same_capture,
    choose_cameras,
    choose_frames,
    read_frames,
    uncompressed_frames,
)
from splatreel.evaluation.metrics import psnr
from splatreel.play.timeline import Timeline
from splatreel.run.output.reencode import reencode
from splatreel.scene.gaussians import Gaussians

PAPER = EncodeConfig(codec="h265").with_h265(weighted_codebook=False)
"""The paper's codec with logarithms of scales and folded bytes, which cost no quality. `PRINTED` is without them."""
PRINTED = PAPER.with_h265(log_scales=False, fold=False)
CONFIGURATIONS: dict[str, EncodeConfig] = {
    "paper": PAPER,
    "paper, CRF 14": PAPER.with_h265(crf=14),
    "paper, CRF 28": PAPER.with_h265(crf=28),
    "paper, CRF 36": PAPER.with_h265(crf=36),
    "h265, its codebook weighed": EncodeConfig(codec="h265"),
    **{f"predictive {value:g} (--rate {rate})": EncodeConfig(coarseness=value) for rate, value in COARSENESS.items()},
    **{f"predictive {value:g}": EncodeConfig(coarseness=value) for value in (0.8, 1.2, 4.0)},
}
Write = Callable[[Path, EncodeConfig], object]
"""Function that writes a reel into a folder."""


@dataclass(frozen=True)
class RatePoint:
    """Result of one configuration.

    Attributes:
        name: Name of the configuration.
        bytes: Size of the reel.
        offset_bytes: Size of the motion sections.
        psnr: PSNR in dB after decoding.
        loss: PSNR before encoding minus `psnr`, dB.
        sections: Bytes by kind of file and section.
    """

    name: str
    bytes: int
    offset_bytes: int
    psnr: float
    loss: float
    sections: dict[str, dict[str, int]]


class Sweep:
    """Measurement of encodings of one run on held-out cameras.

    Args:
        run: Output folder of a reconstruction.
        capture: Capture of the run.
        frames: Frames to measure.
        progress: Progress display.
        record: File with a line per result. Results of the same run and frames are not measured again.
    """

    def __init__(
        self, run: Path, capture: Capture, frames: Sequence[int], progress: Progress, record: Path | None = None
    ) -> None:
        self.run = run
        self.progress = progress
        self.record = record
        reader = ReelReader(run / "reel")
        check_same_capture(reader.manifest, capture, str(run))
        self.views = choose_cameras(capture, reader.manifest, None)
        check_unseen(reader.manifest, self.views, str(run))
        self.draw = Timeline(reader).render
        self.frames = list(frames)
        names = [view.name for view in self.views]
        self.truths = [truth.copy() for _, truth in read_frames(capture, self.frames, names)]
        self._key = {"run": reader.manifest.groups[0].sha256, "frames": self.frames}
        self._known = self._load()
        self.before = self._cached("before encoding", self._before)["psnr"]

    def measure(self, name: str, config: EncodeConfig, write: Write | None = None) -> RatePoint:
        """Encode, decode and compare.

        Args:
            name: Name of the result.
            config: Encoding settings.
            write: Function that writes the reel; None encodes the run as it is.
        """
        return RatePoint(**self._cached(name, lambda: dataclasses.asdict(self._measure(name, config, write))))

    def _measure(self, name: str, config: EncodeConfig, write: Write | None) -> RatePoint:
        with tempfile.TemporaryDirectory(prefix="splatreel-rates-") as folder:
            if write is None:
                reencode(self.run / "work", Path(folder), config, self.progress)
            else:
                write(Path(folder), config)
            info, timeline = reel_info(folder), Timeline(ReelReader(folder))
            after = self._score(lambda frame: timeline.at(frame / timeline.fps))
        offsets = sum(info.section_bytes["group"].get(section, 0) for section in MOTION)
        return RatePoint(name, info.bytes, offsets, after, self.before - after, info.section_bytes)

    def _before(self) -> dict:
        return {"psnr": self._score(uncompressed_frames(self.run / "work", self.run / "reel"))}

    def _score(self, at: Callable[[int], Gaussians]) -> float:
        """Return the mean PSNR of all views and frames."""
        values = []
        for frame, images in zip(self.frames, self.truths, strict=True):
            gaussians = at(frame)
            for view, truth in zip(self.views, images, strict=True):
                values.append(psnr(np.clip(self.draw(gaussians, view), 0, 1), truth))
        return float(np.mean(values))

    def _load(self) -> dict[str, dict]:
        if self.record is None or not self.record.exists():
            return {}
        try:
            data = read_file(self.record, JSON_BYTES, UsageError)
            lines = [parse_json(line, UsageError, f"{self.record}: a line") for line in data.splitlines()]
            return {line["name"]: line["row"] for line in lines if line["of"] == self._key}
        except (KeyError, TypeError) as error:
            raise UsageError(f"{self.record}: is damaged ({error!r}). Delete it to start over.") from error

    def _cached(self, name: str, work: Callable[[], dict]) -> dict:
        if name not in self._known:
            self._known[name] = work()
            if self.record is not None:
                self.record.parent.mkdir(parents=True, exist_ok=True)
                with self.record.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"name": name, "of": self._key, "row": self._known[name]}) + "\n")
        return self._known[name]


def sweep_of(
    run: Path, capture: Capture, every: int, progress: Progress | None = None, record: Path | None = None
) -> Sweep:
    """Return a sweep over every `every`-th frame that a run and its capture share."""
    manifest = ReelReader(run / "reel").manifest
    frames = choose_frames(min(capture.frames, manifest.frames), None, manifest.first_frame)[::every]
    return Sweep(run, capture, frames, progress or Silent(), record)


def rate_distortion_points(sweep: Sweep, names: Sequence[str] | None = None) -> list[RatePoint]:
    """Measure all of CONFIGURATIONS, or those named. Raise `UsageError` for an unknown name."""
    unknown = set(names or []) - set(CONFIGURATIONS)
    if unknown:
        raise UsageError(f"No configuration is called {min(unknown)!r}. Known are {', '.join(CONFIGURATIONS)}.")
    return [sweep.measure(name, CONFIGURATIONS[name]) for name in names or CONFIGURATIONS]


def bytes_at(rows: list[RatePoint], loss: float) -> float | None:
    """Return the smallest size with a loss of at most `loss`, interpolated by the logarithm of the size.

    Coarser steps may lose less on held-out views. Where the curve turns, the smaller end counts. None outside the
    measured range.
    """
    points = sorted((np.log(row.bytes), row.loss) for row in rows)
    for (small, most), (large, least) in pairwise(points):
        if most >= loss >= least:
            share = (most - loss) / (most - least) if most > least else 0.0
            return float(np.exp(small + share * (large - small)))
    return None


def curves(rows: list[RatePoint]) -> dict[str, list[tuple[float, float]]]:
    """Return (bytes, PSNR) pairs of the paper's codec and of the predictive codec."""
    return {
        codec: [(row.bytes, row.psnr) for row in rows if row.name.startswith(codec)]
        for codec in ("paper", "predictive")
    }


def table(rows: list[RatePoint]) -> str:
    """Return the results as Markdown, and the size of the predictive codec at the paper's quality."""
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
    theirs, own = curves(rows).values()
    delta = bd_rate(theirs, own)
    lines.append(
        "\nBD-rate: the two have no quality in common."
        if delta is None
        else f"\nBD-rate of predictive against the paper's codec: {delta:+.1%}."
    )
    return "\n".join(lines) + "\n"


Curve = Sequence[tuple[float, float]]
"""Pairs (bytes, PSNR in dB) of one codec at several settings."""


def bd_rate(anchor: Curve, test: Curve) -> float | None:
    """Return Bjontegaard's delta rate: mean relative difference of bytes at equal PSNR; -0.3 means 30 % fewer bytes than the anchor.

    Logarithms of bytes are interpolated over PSNR by monotone cubics, through the Pareto-optimal settings.

    Returns:
        The delta rate, or None if a curve has fewer than two such settings or the curves share no PSNR range.
    """
    curves = [_pareto_front(curve) for curve in (anchor, test)]
    if min(len(curve) for curve in curves) < 2:
        return None
    low = max(curve[0, 1] for curve in curves)
    high = min(curve[-1, 1] for curve in curves)
    if not low < high:
        return None
    means = [PchipInterpolator(c[:, 1], np.log(c[:, 0])).integrate(low, high) / (high - low) for c in curves]
    return float(np.exp(means[1] - means[0]) - 1)


def _pareto_front(curve: Curve) -> np.ndarray:
    """Return the Pareto-optimal pairs as [K, 2] (bytes, PSNR), PSNR ascending."""
    best: list[tuple[float, float]] = []
    for size, quality in sorted(curve):
        if not best or quality > best[-1][1]:
            best.append((size, quality))
    return np.array(best).reshape(-1, 2)
