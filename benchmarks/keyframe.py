"""The first keyframe alone, with few cameras and several seeds: what a guard is worth, and how far chance decides.

python benchmarks/keyframe.py CAPTURE --width 320 --cameras 10 --parts all,no-roughness
"""

import dataclasses
import time
from pathlib import Path

import numpy as np
import tyro

from ablation import PARTS
from record import record
from splatreel.capture.base import Capture
from splatreel.capture.opening import open_capture
from splatreel.config import Config, Quality, preset
from splatreel.config.settings import changed
from splatreel.evaluation.bench.oracle import held_out_views
from splatreel.evaluation.metrics import psnr
from splatreel.kernels.image import render_image
from splatreel.motion.temporal_mean import temporal_mean
from splatreel.process import keep_freed_memory
from splatreel.recon.train.single_frame import reconstruct_single_frame
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
    chosen, views = few(source.training_cameras, cameras), held_out_views(source)
    frames = source.read(0, min(source.frames, preset(quality).group.length), [camera.name for camera in chosen])
    truths = source.read(0, 1, [view.name for view in views])[0].astype(np.float32) / 255
    for part in parts.split(","):
        config = changed(preset(quality), PARTS[part])
        images = temporal_mean(frames) if config.keyframe.temporal_mean else frames[0]
        runs, before = [], time.process_time()
        for seed in range(seeds):
            rendered = trained(source, chosen, images, dataclasses.replace(config, seed=seed), views)
            runs.append([psnr(image, truth) for image, truth in zip(rendered, truths, strict=True)])
        values = {"quality": quality, "cameras": len(chosen), "psnr": np.mean(runs), "psnr_of_seeds": runs}
        values["processor_seconds"] = round((time.process_time() - before) / seeds, 1)
        record(f"keyframe {source.name} {source.width}, {len(chosen)} cameras, {part}", values, note)
        shown = ", ".join("/".join(f"{value:.2f}" for value in run) for run in runs)
        print(
            f"{part}: {np.mean(runs):.2f} dB in {values['processor_seconds']} s of processor; held-out cameras of each seed: {shown}",
            flush=True,
        )


def few(cameras: list[Camera], count: int | None) -> list[Camera]:
    """Evenly chosen ones of the cameras in their order; all of them without a count."""
    if count is None or count >= len(cameras):
        return cameras
    return [cameras[i] for i in np.linspace(0, len(cameras) - 1, count).round().astype(int)]


def trained(
    source: Capture, cameras: list[Camera], images: np.ndarray, config: Config, views: list[Camera]
) -> list[np.ndarray]:
    """What the held-out cameras see of a keyframe of images [C, H, W, 3] uint8, before encoding; each [H, W, 3] 0..1."""
    points = {"points": source.points, "point_colors": source.point_colors, "near": source.near}
    gaussians, layout = reconstruct_single_frame(cameras, images, config, **points)
    how = {"near": layout.near, "antialias": config.antialias, "background": layout.background}
    return [np.clip(render_image(gaussians, view, **how), 0, 1) for view in views]


if __name__ == "__main__":
    tyro.cli(main)
