"""Content of oracle.json and oracle.md: quality of single frames, and the distance of a reel to them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from splatreel.evaluation.evaluate import Quality


@dataclass(frozen=True)
class Score:
    """Quality of one frame as the mean over held-out cameras, or the mean of several frames.

    Attributes:
        whole: Quality of whole images.
        moving: Quality of pixels with motion; None without motion.
    """

    whole: Quality
    moving: Quality | None

    @staticmethod
    def mean(items: list[Score]) -> Score:
        """Return the arithmetic mean of each metric. The mean of `moving` is over the scores that have it."""
        moving = [s.moving for s in items if s.moving is not None]
        return Score(Quality.mean([s.whole for s in items]), Quality.mean(moving) if moving else None)

    @staticmethod
    def from_dict(value: dict[str, Any]) -> Score:
        """Return the score of a dictionary from `dataclasses.asdict`. Raise TypeError or KeyError for anything else."""
        moving = value["moving"]
        return Score(Quality(**value["whole"]), None if moving is None else Quality(**moving))


@dataclass(frozen=True)
class SingleFrame:
    """Frame reconstructed independently.

    Attributes:
        frame: Number of the frame.
        score: Quality before encoding.
        decoded: Quality of whole images after encoding.
        points: Number of points.
        bytes: Size of the encoded points.
        seconds: Wall time of initial points and training.
        device: cpu or cuda.
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
        """Return the frame of a dictionary from `dataclasses.asdict`. Raise TypeError or KeyError for anything else."""
        nested = {"score": Score.from_dict(value["score"]), "decoded": Quality(**value["decoded"])}
        return SingleFrame(**(value | nested))


@dataclass(frozen=True)
class OracleReport:
    """Single frames and, unless `reel` is empty, the same frames of a reel in the same order."""

    frames: list[SingleFrame]
    reel: list[Score]

    def mean(self) -> Score:
        """Return the mean score of the single frames."""
        return Score.mean([frame.score for frame in self.frames])

    def decoded(self) -> Quality:
        """Return the mean quality of the single frames after encoding."""
        return Quality.mean([frame.decoded for frame in self.frames])

    def distance(self) -> dict[str, float | None]:
        """Return the difference in dB between the mean PSNR of the single frames and of the reel."""
        return psnr_distance(self.mean(), Score.mean(self.reel))

    def reel_dict(self, name: str) -> dict[str, Any]:
        """Return the part of oracle.json about a named reel."""
        pairs = zip(self.frames, self.reel, strict=True)
        frames = [{"frame": f.frame, **dataclasses.asdict(r), "distance": psnr_distance(f.score, r)} for f, r in pairs]
        return {"reel": name, "frames": frames, "distance": self.distance()}

    def to_markdown(self) -> str:
        """Return a table of the single frames and, with a reel, a table of its distance."""
        count = len(self.frames)
        rows = [_single_frame_row(str(f.frame), f.score, f.decoded, f.points, f.bytes, f.seconds) for f in self.frames]
        sums = [sum(getattr(f, name) for f in self.frames) / count for name in ("points", "bytes", "seconds")]
        rows.append(_single_frame_row("mean", self.mean(), self.decoded(), *sums))
        heads = ["frame", "PSNR dB", "per channel", "colors fitted", "SSIM", "moving dB", "moving SSIM", "decoded dB"]
        lines = [
            "# Oracle",
            "",
            "Held-out cameras against an independent static reconstruction of each frame, not encoded.",
        ]
        lines += [
            "Moving: only the pixels that differ from their camera's median image. Decoded: after encoding. Colors fitted: after one "
            "gain for each color channel of each image.",
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


def psnr_distance(oracle: Score, reel: Score) -> dict[str, float | None]:
    """Return how many dB the reel's PSNR is below the oracle's, for whole images and for pixels with motion (None without motion)."""
    moving = None
    if oracle.moving is not None and reel.moving is not None:
        moving = oracle.moving.psnr - reel.moving.psnr
    return {"whole": oracle.whole.psnr - reel.whole.psnr, "moving": moving}


def _single_frame_row(
    name: str, score: Score, decoded: Quality, points: float, size: float, seconds: float
) -> list[str]:
    whole, moving = score.whole, score.moving
    fitted = "" if whole.psnr_color_fitted is None else f"{whole.psnr_color_fitted:.2f}"
    cells = [name, f"{whole.psnr:.2f}", f"{whole.psnr_per_channel:.2f}", fitted, f"{whole.ssim:.4f}"]
    cells += ["", ""] if moving is None else [f"{moving.psnr:.2f}", f"{moving.ssim:.4f}"]
    return [*cells, f"{decoded.psnr:.2f}", f"{points:,.0f}", f"{size / 1e6:.3f} MB", f"{seconds:.1f} s"]


def _distance_row(name: str, oracle: Score, reel: Score) -> list[str]:
    distance, a, b = psnr_distance(oracle, reel), oracle.whole, reel.whole
    cells = [name, f"{a.psnr:.2f}", f"{b.psnr:.2f}", f"{distance['whole']:.2f}", f"{a.ssim:.4f}", f"{b.ssim:.4f}"]
    if oracle.moving is None or reel.moving is None:
        return [*cells, "", "", ""]
    return [*cells, f"{oracle.moving.psnr:.2f}", f"{reel.moving.psnr:.2f}", f"{distance['moving']:.2f}"]


def _table(heads: list[str], rows: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (heads, ["---"] * len(heads), *rows)]
