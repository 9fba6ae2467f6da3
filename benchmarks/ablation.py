"""What each part of the reconstruction is worth: a capture again and again, each time with one part changed.

python benchmarks/ablation.py CAPTURE --width 320 --frames 0:30

The same command goes on where it was interrupted: each part has a folder of its own.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from record import machine, record
from splatreel.capture.base import Capture
from splatreel.capture.opening import open_capture
from splatreel.cli.options import parse_frames
from splatreel.codec.info import reel_info
from splatreel.config import Quality, preset
from splatreel.config.settings import changed
from splatreel.evaluation.bench.oracle import HeldOutPictures, held_out_views, median_pictures, moving_pixels
from splatreel.evaluation.bench.oracle_report import Score
from splatreel.play.timeline import open_reel
from splatreel.process import keep_freed_memory
from splatreel.progress import console
from splatreel.recon.pipeline import Result, reconstruct

PARTS: dict[str, dict[str, Any]] = {
    "all": {},
    "no-tracks": {"group.tracks": False},
    "no-antialias": {"antialias": False},
    "no-shade": {"group.appearance": False},
    "no-light": {"layering.relighting": False},
    "no-conversion": {"layering.adapt_every": 0},
    "faint-kept": {"group.faint_share": 0.0},
    "one-flow": {"layering.flow_frames": 1},
    "no-gains": {"correct_colors": False},
    "poses-as-said": {"check_poses": False},
    "uneven-exposure": {"even_exposure": False},
    "in-step": {"group.time_offsets": False},
    "no-arap": {"group.lambda_arap": 0.0},
    "sh-degree-1": {"keyframe.sh_degree": 1},
    "no-price": {"keyframe.lambda_opacity": 0.0},
    "no-sh-price": {"group.lambda_sh": 0.0},
    "no-spread": {"keyframe.lambda_spread": 0.0},
    "no-roughness": {"keyframe.lambda_roughness": 0.0},
    "converted-anywhere": {"layering.adapt_changed_share": 0.0},
    "not-steady": {"keyframe.temporal_mean": False},
    "no-coarse": {"keyframe.coarse_share": 0.0},
    "full-size": {"training_megapixels": 0.0},
    "smaller": {"training_megapixels": 0.2},
    "progressive": {"group.progressive_share": 0.5},
    "hashgrid": {"group.deformation": "hashgrid"},
}
"""By name the fields that differ from the preset."""
EVERY = 3
"""Frames that are looked at."""


def main(
    capture: tyro.conf.Positional[Path],
    /,
    width: int | None = None,
    frames: str = "0:30",
    parts: str | None = None,
    quality: Quality = "standard",
    seed: int = 0,
    out: Path | None = None,
    note: str = "",
) -> None:
    """Reconstruct once for each part, evaluate, record, and print the table. parts: some of them, with commas."""
    keep_freed_memory()
    source = open_capture(capture, width=width, frames=parse_frames(frames))
    out = out or Path(f"out/ablation-{source.name}-{source.width}-{quality}")
    print("| | whole dB | SSIM | moving dB | moving SSIM | dynamic | kB | s |\n|---|---|---|---|---|---|---|---|")
    for part in parts.split(",") if parts else PARTS:
        config = changed(dataclasses.replace(preset(quality), seed=seed), PARTS[part])
        before, progress = machine(), console()
        try:
            result = reconstruct(source, out / part, config, progress=progress)
        finally:
            progress.close()
        values = measured(result, source) | {"quality": quality, "seed": seed, "machine_before": before}
        record(f"ablation {source.name} {source.width}, {part}", values, note)
        cells = [f"{values[name]:.2f}" for name in ("psnr", "ssim", "psnr_moving", "ssim_moving")]
        cells += [f"{100 * values['dynamic_share']:.1f} %", f"{values['reel_bytes'] / 1e3:.0f}"]
        print(f"| {part} | {' | '.join(cells)} | {values['seconds_total']:.0f} |", flush=True)


def measured(result: Result, capture: Capture) -> dict[str, Any]:
    """The decoded reel against held-out cameras, whole and where something moves; shares of points and of pixels that move."""
    played, views = open_reel(result.reel), held_out_views(capture)
    manifest = played.manifest
    names = [view.name for view in views]
    medians = median_pictures(capture, names)
    scores, pixels = [], []
    for frame in range(0, capture.frames, EVERY):
        truths = capture.read(frame, 1, names)[0].astype(np.float32) / 255
        masks = [moving_pixels(truth, median) for truth, median in zip(truths, medians, strict=True)]
        held_out = HeldOutPictures(views, truths, masks, None)
        scores.append(held_out.score(played.at(frame / played.fps), played.render))
        pixels.append(np.mean(masks))
    mean = Score.mean(scores)
    dynamic, static = (sum(file.points for file in files) for files in (manifest.groups[:1], manifest.layers[:1]))
    moving = mean.moving or mean.whole
    return {
        "psnr": mean.whole.psnr,
        "ssim": mean.whole.ssim,
        "psnr_moving": moving.psnr,
        "ssim_moving": moving.ssim,
        "dynamic_share": dynamic / (dynamic + static),
        "moving_pixels": float(np.mean(pixels)),
        "reel_bytes": reel_info(result.reel).bytes,
        "seconds_total": round(sum(result.seconds.values()), 1),
        "width": capture.width,
        "height": capture.height,
        "frames": capture.frames,
    }


if __name__ == "__main__":
    tyro.cli(main)
