"""The contents of oracle.json and oracle.md: how good single frames are, and how far below them a reel is."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from splatreel.evaluation.report import Quality


@dataclass(frozen=True)
class Score:
    """One frame, as the mean over the held-out cameras, or the mean of several frames.

    whole: of whole pictures. moving: of the pixels where something moves only; None where nothing does.
    """

    whole: Quality
    moving: Quality | None

    @staticmethod
    def mean(items: list[Score]) -> Score:
        """Arithmetic mean of each number; `moving` over those items that have it."""
        moving = [s.moving for s in items if s.moving is not None]
        return Score(Quality.mean([s.whole for s in items]), Quality.mean(moving) if moving else None)

    @staticmethod
    def from_dict(value: dict[str, Any]) -> Score:
        """Raises TypeError or KeyError for anything else than `dataclasses.asdict` gave."""
        moving = value["moving"]
        return Score(Quality(**value["whole"]), None if moving is None else Quality(**moving))


@dataclass(frozen=True)
class SingleFrame:
    """A frame reconstructed on its own. score: before encoding; decoded: whole pictures of what a reader of its file shows.

    bytes: of the file of its points. seconds: wall time of initial points and training. device: cpu or cuda.
    """

    frame: int
    score: Score
    decoded: Quality
    points: int
    bytes: int
    seconds: float
    device: str

    @staticmethod
    def from_dict(value: dict[str, Any]) -> SingleFrame:
        """Raises TypeError or KeyError for anything else than `dataclasses.asdict` gave."""
        nested = {"score": Score.from_dict(value["score"]), "decoded": Quality(**value["decoded"])}
        return SingleFrame(**(value | nested))


@dataclass(frozen=True)
class OracleReport:
    """Frames reconstructed each on its own and, if reel is not empty, the same frames of a reel, in the same order."""

    frames: list[SingleFrame]
    reel: list[Score]

    def mean(self) -> Score:
        return Score.mean([frame.score for frame in self.frames])

    def decoded(self) -> Quality:
        return Quality.mean([frame.decoded for frame in self.frames])

    def distance(self) -> dict[str, float | None]:
        """dB that the reel's mean PSNR is below the single frames', of whole pictures and where something moves."""
        return below(self.mean(), Score.mean(self.reel))

    def reel_dict(self, name: str) -> dict[str, Any]:
        """The part of oracle.json about the reel of that name."""
        pairs = zip(self.frames, self.reel, strict=True)
        frames = [{"frame": f.frame, **dataclasses.asdict(r), "distance": below(f.score, r)} for f, r in pairs]
        return {"reel": name, "frames": frames, "distance": self.distance()}

    def to_markdown(self) -> str:
        """A table of the single frames and, if there is one, a table of the reel's distance."""
        count = len(self.frames)
        rows = [_still_row(str(f.frame), f.score, f.decoded, f.points, f.bytes, f.seconds) for f in self.frames]
        sums = [sum(getattr(f, name) for f in self.frames) / count for name in ("points", "bytes", "seconds")]
        rows.append(_still_row("mean", self.mean(), self.decoded(), *sums))
        heads = ["frame", "PSNR dB", "per channel", "SSIM", "moving dB", "moving SSIM", "decoded dB"]
        lines = [
            "# Oracle",
            "",
            "Held-out cameras against a static reconstruction of each frame on its own, not encoded.",
        ]
        lines += [
            "Moving: only the pixels that differ from their camera's median picture. Decoded: after encoding.",
            "",
        ]
        lines += _table([*heads, "points", "size", "time"], rows)
        if self.reel:
            pairs = [(str(f.frame), f.score, r) for f, r in zip(self.frames, self.reel, strict=True)]
            rows = [_distance_row(*pair) for pair in (*pairs, ("mean", self.mean(), Score.mean(self.reel)))]
            heads = ["frame", "oracle dB", "reel dB", "below", "oracle SSIM", "reel SSIM"]
            heads += ["moving: oracle dB", "reel dB", "below"]
            lines += ["", "## The decoded reel, and how far it is below", "", *_table(heads, rows)]
        return "\n".join(lines) + "\n"


def below(oracle: Score, reel: Score) -> dict[str, float | None]:
    """dB that one PSNR is below the other, of whole pictures and where something moves (None where nothing does)."""
    moving = None
    if oracle.moving is not None and reel.moving is not None:
        moving = oracle.moving.psnr - reel.moving.psnr
    return {"whole": oracle.whole.psnr - reel.whole.psnr, "moving": moving}


def _still_row(name: str, score: Score, decoded: Quality, points: float, size: float, seconds: float) -> list[str]:
    whole, moving = score.whole, score.moving
    cells = [name, f"{whole.psnr:.2f}", f"{whole.psnr_per_channel:.2f}", f"{whole.ssim:.4f}"]
    cells += ["", ""] if moving is None else [f"{moving.psnr:.2f}", f"{moving.ssim:.4f}"]
    return [*cells, f"{decoded.psnr:.2f}", f"{points:,.0f}", f"{size / 1e6:.3f} MB", f"{seconds:.1f} s"]


def _distance_row(name: str, oracle: Score, reel: Score) -> list[str]:
    distance, a, b = below(oracle, reel), oracle.whole, reel.whole
    cells = [name, f"{a.psnr:.2f}", f"{b.psnr:.2f}", f"{distance['whole']:.2f}", f"{a.ssim:.4f}", f"{b.ssim:.4f}"]
    if oracle.moving is None or reel.moving is None:
        return [*cells, "", "", ""]
    return [*cells, f"{oracle.moving.psnr:.2f}", f"{reel.moving.psnr:.2f}", f"{distance['moving']:.2f}"]


def _table(heads: list[str], rows: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (heads, ["---"] * len(heads), *rows)]
