"""Rate and distortion: one reconstruction encoded in many ways, each decoded again and compared with cameras held out."""

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

from splatreel.capture.base import Capture
from splatreel.codec.info import reel_info
from splatreel.codec.reader import ReelReader
from splatreel.config import COARSENESS, EncodeConfig
from splatreel.errors import UsageError
from splatreel.evaluation.evaluate import check_same_capture, check_unseen, choose_cameras, choose_frames, read_frames
from splatreel.evaluation.metrics import psnr
from splatreel.evaluation.uncompressed import uncompressed_frames
from splatreel.play.timeline import Timeline
from splatreel.progress import Progress, Silent
from splatreel.recon.encode.reencode import reencode
from splatreel.recon.run.device import pick_device
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.untrusted import JSON_BYTES, parse_json, read_file

PAPER = EncodeConfig(codec="h265").with_h265(weighted_codebook=False)
"""The paper's codec with logarithms of scales and folded bytes, which cost nothing; `PRINTED` is without them."""
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
MOTION = ("offsets", "dx", "dq", "shade")
Write = Callable[[Path, EncodeConfig], object]
"""Writes a reel into a folder."""


@dataclass(frozen=True)
class RatePoint:
    """One way to encode. loss: dB below the PSNR before encoding. sections: bytes by kind of file and section."""

    name: str
    bytes: int
    offset_bytes: int
    psnr: float
    loss: float
    sections: dict[str, dict[str, int]]


class Sweep:
    """Measures encodings of one run against cameras held out. frames: which of the run's.

    record: a file that gets a line a row; rows that it has already of the same run and frames are not measured again.
    Raises what reading the run and its capture raises.
    """

    def __init__(
        self, run: Path, capture: Capture, frames: Sequence[int], progress: Progress, record: Path | None = None
    ) -> None:
        self.run, self.progress, self.record = run, progress, record
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
        """Encode, decode and compare. write: how the reel is written; by default the run as it is."""
        return RatePoint(**self._cached(name, lambda: dataclasses.asdict(self._measure(name, config, write))))

    def _measure(self, name: str, config: EncodeConfig, write: Write | None) -> RatePoint:
        with tempfile.TemporaryDirectory(prefix="splatreel-rates-") as folder:
            if write is None:
                reencode(self.run / "work", Path(folder), config, pick_device("auto"), self.progress)
            else:
                write(Path(folder), config)
            info, timeline = reel_info(folder), Timeline(ReelReader(folder))
            after = self._score(lambda frame: timeline.at(frame / timeline.fps))
        offsets = sum(info.section_bytes["group"].get(section, 0) for section in MOTION)
        return RatePoint(name, info.bytes, offsets, after, self.before - after, info.section_bytes)

    def _before(self) -> dict:
        return {"psnr": self._score(uncompressed_frames(self.run / "work", self.run / "reel"))}

    def _score(self, at: Callable[[int], Gaussians]) -> float:
        """Mean PSNR of all views and frames."""
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
    """A sweep over every `every`-th frame that a run and its capture share."""
    manifest = ReelReader(run / "reel").manifest
    frames = choose_frames(min(capture.frames, manifest.frames), None, manifest.first_frame)[::every]
    return Sweep(run, capture, frames, progress or Silent(), record)


def rate_distortion_points(sweep: Sweep, names: Sequence[str] | None = None) -> list[RatePoint]:
    """All ways of CONFIGURATIONS, or those named. Raises `UsageError` for an unknown name."""
    unknown = set(names or []) - set(CONFIGURATIONS)
    if unknown:
        raise UsageError(f"No configuration is called {min(unknown)!r}. Known are {', '.join(CONFIGURATIONS)}.")
    return [sweep.measure(name, CONFIGURATIONS[name]) for name in names or CONFIGURATIONS]


def bytes_at(rows: list[RatePoint], loss: float) -> float | None:
    """The fewest bytes at which the configurations in rows lose no more than `loss`, in between by the logarithm of the bytes.

    Coarser steps may lose less on views held out: where the curve turns, its smaller end counts. None outside of what they cover.
    """
    points = sorted((np.log(row.bytes), row.loss) for row in rows)
    for (small, most), (large, least) in pairwise(points):
        if most >= loss >= least:
            share = (most - loss) / (most - least) if most > least else 0.0
            return float(np.exp(small + share * (large - small)))
    return None


def curves(rows: list[RatePoint]) -> dict[str, list[tuple[float, float]]]:
    """(bytes, PSNR) of the paper's codec and of ours."""
    return {
        codec: [(row.bytes, row.psnr) for row in rows if row.name.startswith(codec)]
        for codec in ("paper", "predictive")
    }


def table(rows: list[RatePoint]) -> str:
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
    theirs, own = curves(rows).values()
    delta = bd_rate(theirs, own)
    lines.append(
        "\nBD-rate: the two have no quality in common."
        if delta is None
        else f"\nBD-rate of predictive against the paper's codec: {delta:+.1%}."
    )
    return "\n".join(lines) + "\n"


Curve = Sequence[tuple[float, float]]
"""(bytes, PSNR in dB) of one codec at several settings."""


def bd_rate(anchor: Curve, test: Curve) -> float | None:
    """Mean difference of bytes at equal PSNR, as a share of the anchor's: -0.3 is 30 % fewer.

    Logarithms of bytes are interpolated over PSNR by monotone cubics, through those settings that no other one beats in both.
    None where fewer than two of them are left, or the curves have no quality in common.
    """
    curves = [_front(curve) for curve in (anchor, test)]
    if min(len(curve) for curve in curves) < 2:
        return None
    low = max(curve[0, 1] for curve in curves)
    high = min(curve[-1, 1] for curve in curves)
    if not low < high:
        return None
    means = [PchipInterpolator(c[:, 1], np.log(c[:, 0])).integrate(low, high) / (high - low) for c in curves]
    return float(np.exp(means[1] - means[0]) - 1)


def _front(curve: Curve) -> np.ndarray:
    """[K, 2] (bytes, PSNR) with rising PSNR of the settings that are best for their bytes."""
    best: list[tuple[float, float]] = []
    for size, quality in sorted(curve):
        if not best or quality > best[-1][1]:
            best.append((size, quality))
    return np.array(best).reshape(-1, 2)
