"""Report of an evaluation, as report.json and as Markdown."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path

from splatreel.errors import UsageError
from splatreel.recon.coverage.rating import SCALE
from splatreel.scene.atomic import replacing
from splatreel.scene.untrusted import is_number, read_json


@dataclass(frozen=True)
class Quality:
    """Image quality of one image, or the mean over several. `lpips` is None without its weights."""

    psnr: float
    psnr_per_channel: float
    ssim: float
    lpips: float | None = None

    @staticmethod
    def mean(items: list[Quality]) -> Quality:
        """Return the arithmetic mean of each metric."""
        names = ("psnr", "psnr_per_channel", "ssim")
        lpips = [q.lpips for q in items if q.lpips is not None]
        values = {n: sum(getattr(q, n) for q in items) / len(items) for n in names}
        return Quality(**values, lpips=sum(lpips) / len(lpips) if len(lpips) == len(items) else None)


@dataclass(frozen=True)
class Report:
    """Content of report.json.

    Attributes:
        psnr: PSNR in dB over all pixels and channels of an image, mean over frames and cameras.
        psnr_per_channel: Mean of the PSNR of each channel.
        ssim: Structural similarity.
        lpips: LPIPS (VGG); None without its weights.
        psnr_undecoded: PSNR before encoding; None if that model is not available.
        flicker: Mean absolute error of frame-to-frame changes within groups, gray levels of 255; None without
            consecutive frames.
        flicker_borders: The same where one group fades into the next.
        reel_bytes: Size of all files of the reel.
        first_view_bytes: Bytes that a player loads for its first image.
        bytes_per_second: Bytes per second of video, without the first layers, which are loaded once.
        seconds: Wall time of each stage.
        points_static: Mean number of static points per group.
        points_dynamic: Mean number of dynamic points per group.
        peak_memory_bytes: Peak memory of the process.
        device: Device of the reconstruction.
        frames: Number of evaluated frames.
        width: Width of the images.
        height: Height of the images.
        cameras: Per camera: name, psnr, psnr_per_channel, ssim, lpips and degrees. `degrees` is the angle to the
            nearest training camera, seen from the focus point; None without a focus point.
        per_frame: Per frame: frame, psnr, psnr_per_channel, ssim, lpips.
        trained_on: Names of the training cameras.
        held_out: Names of evaluated cameras that were not trained on. Empty if training views were evaluated, which do
            not measure novel views.
        coverage: Sentences about the coverage of the training cameras.
    """

    psnr: float
    psnr_per_channel: float
    ssim: float
    lpips: float | None
    psnr_undecoded: float | None
    flicker: float | None
    flicker_borders: float | None
    reel_bytes: int
    first_view_bytes: int
    bytes_per_second: float
    seconds: dict[str, float]
    points_static: float
    points_dynamic: float
    peak_memory_bytes: int | None
    device: str
    frames: int
    width: int
    height: int
    cameras: list[dict] = field(default_factory=list)
    per_frame: list[dict] = field(default_factory=list)
    trained_on: list[str] = field(default_factory=list)
    held_out: list[str] = field(default_factory=list)
    coverage: list[str] = field(default_factory=list)

    def to_json(self) -> str:
        """Return the text of report.json."""
        return json.dumps(dataclasses.asdict(self), indent=1, allow_nan=False)

    def to_markdown(self) -> str:
        """Return a summary: a table of the whole and a table of the cameras."""
        rows = [
            ("PSNR, decoded", f"{self.psnr:.2f} dB ({self.psnr_per_channel:.2f} as the mean of channels)"),
            (
                "PSNR, before encoding",
                "not measured" if self.psnr_undecoded is None else f"{self.psnr_undecoded:.2f} dB",
            ),
            ("SSIM", f"{self.ssim:.4f}"),
            ("LPIPS (VGG)", "not measured: no weights" if self.lpips is None else f"{self.lpips:.4f}"),
            ("Flicker", describe_flicker(self.flicker, self.flicker_borders)),
            ("Reel", f"{megabytes(self.reel_bytes)}, {megabytes(self.bytes_per_second)} a second of video"),
            ("First picture", megabytes(self.first_view_bytes)),
            ("Points, mean of a group", f"{self.points_static:,.0f} static, {self.points_dynamic:,.0f} dynamic"),
            ("Video", f"{self.frames} frames, evaluated at {self.width} x {self.height}"),
            ("Time", ", ".join(f"{name} {value:.1f} s" for name, value in self.seconds.items()) or "not measured"),
            ("Peak memory", "unknown" if self.peak_memory_bytes is None else megabytes(self.peak_memory_bytes)),
            ("Device", self.device),
        ]
        lines = ["# Evaluation", "", self._views(), "", SCALE, "", "| | |", "|---|---|"]
        lines += [f"| {name} | {value} |" for name, value in rows]
        if self.coverage:
            lines += ["", "What the cameras that it was trained on allow:", ""]
            lines += [f"- {sentence}" for sentence in self.coverage]
        lines += [
            "",
            "| camera | PSNR dB | SSIM | LPIPS | degrees from the nearest trained on |",
            "|---|---|---|---|---|",
        ]
        for camera in self.cameras:
            lpips = "" if camera["lpips"] is None else f"{camera['lpips']:.4f}"
            degrees = "" if camera.get("degrees") is None else f"{camera['degrees']:.1f}"
            lines.append(f"| {camera['name']} | {camera['psnr']:.2f} | {camera['ssim']:.4f} | {lpips} | {degrees} |")
        return "\n".join(lines) + "\n"

    def _views(self) -> str:
        """Describe the evaluated views."""
        if self.held_out or not self.trained_on:
            return "Held-out cameras, rendered from the decoded reel."
        return (
            "Training views, rendered from the decoded reel: it was trained on these cameras, so how good new views are was not "
            "measured. For that keep cameras: `splatreel reconstruct --hold-out NAME,NAME`."
        )

    def write(self, folder: Path) -> None:
        """Write report.json and report.md atomically into a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "report.json", self.to_json() + "\n")
        write_text(folder / "report.md", self.to_markdown())

    @staticmethod
    def read(path: Path) -> Report:
        """Read a report.json. Raise `UsageError` if it is not a report of this version."""
        try:
            report = Report(**read_json(path, lambda text: UsageError(f"{text} It is not a report of this version.")))
            if not all(is_number(value) for value in (report.psnr, report.ssim, report.reel_bytes, report.frames)):
                raise TypeError("a number is none")
            return report
        except TypeError as error:
            raise UsageError(
                f"{path}: not a report of this version ({error}). Run `splatreel evaluate` again."
            ) from error


def describe_flicker(within: float | None, borders: float | None) -> str:
    """Describe the flicker within groups and at borders."""
    if within is None:
        return "not measured: no two frames in a row"
    beyond = "" if borders is None else f", {borders:.2f} where groups meet"
    return f"steps from frame to frame are off by {within:.2f} gray levels{beyond}"


def megabytes(count: float) -> str:
    """Format a size, for example 12.3 MB; 1 MB is 10^6 bytes."""
    return f"{count / 1e6:.3g} MB" if count < 1e8 else f"{count / 1e6:,.0f} MB"


def write_text(path: Path, text: str) -> None:
    """Replace a text file atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
