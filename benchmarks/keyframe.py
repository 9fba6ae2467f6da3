"""The first keyframe alone, with few cameras and several seeds: what a guard is worth, and how far chance decides.

python benchmarks/keyframe.py CAPTURE --width 320 --cameras 10 --parts all,no-roughness
"""

import dataclasses
from pathlib import Path

import numpy as np
import torch
import tyro

from ablation import PARTS, changed
from record import record
from splatreel.capture.base import Capture
from splatreel.capture.opening import open_capture
from splatreel.cli.main import keep_freed_memory
from splatreel.config import Config, Quality, preset
from splatreel.evaluation.metrics import psnr
from splatreel.evaluation.oracle import held_out_views
from splatreel.kernels.image import render_image
from splatreel.motion.steady import steady
from splatreel.recon.still import reconstruct_still
from splatreel.scene.camera import Camera


def main(
    capture: tyro.conf.Positional[Path],
    /,
    width: int | None = None,
    cameras: int | None = None,
    parts: str = "all,no-roughness",
    seeds: int = 3,
    quality: Quality = "standard",
    note: str = "",
) -> None:
    """Train frame 0 and measure it on the held-out cameras. cameras: train on this many, evenly chosen. parts: of the ablation."""
    keep_freed_memory()
    source = open_capture(capture, width=width)
    chosen = few(source.training_cameras, cameras)
    for part in parts.split(","):
        config = changed(preset(quality), PARTS[part])
        runs = [trained(source, chosen, dataclasses.replace(config, seed=seed)) for seed in range(seeds)]
        values = {"quality": quality, "cameras": len(chosen), "psnr": np.mean(runs), "psnr_of_seeds": runs}
        record(f"keyframe {source.name} {source.width}, {len(chosen)} cameras, {part}", values, note)
        shown = ", ".join("/".join(f"{value:.2f}" for value in run) for run in runs)
        print(f"{part}: {np.mean(runs):.2f} dB; held-out cameras of each seed: {shown}", flush=True)


def few(cameras: list[Camera], count: int | None) -> list[Camera]:
    """Evenly chosen ones of the cameras in their order; all of them without a count."""
    if count is None or count >= len(cameras):
        return cameras
    return [cameras[i] for i in np.linspace(0, len(cameras) - 1, count).round().astype(int)]


def trained(source: Capture, cameras: list[Camera], config: Config) -> list[float]:
    """dB of every held-out camera, before encoding."""
    frames = source.read(0, min(source.frames, config.group.length), [camera.name for camera in cameras])
    images = steady(frames) if config.keyframe.steady else frames[0]
    points = {"points": source.points, "point_colors": source.point_colors, "near": source.near}
    gaussians, layout = reconstruct_still(cameras, images, config, device=torch.device("cpu"), **points)
    views = held_out_views(source)
    truths = source.read(0, 1, [view.name for view in views])[0].astype(np.float32) / 255
    how = {"near": layout.near, "antialias": config.antialias}
    return [
        psnr(np.clip(render_image(gaussians, view, **how), 0, 1), truth)
        for view, truth in zip(views, truths, strict=True)
    ]


if __name__ == "__main__":
    tyro.cli(main)
