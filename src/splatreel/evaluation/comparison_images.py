"""Images of an evaluation: truth, render and error of chosen frames, and the layers of moving and static points."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from splatreel.base.atomic import write_bytes
from splatreel.capture.base import Capture
from splatreel.capture.images import encode_image
from splatreel.play.timeline import Moment, Timeline, draw_on_cpu
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians

_ERROR_GAIN = 4
"""Amplification of the displayed error: 1/4 of the range is white."""
BLUE = np.array([0.1, 0.35, 1.0], np.float32)
"""Color of moving points in an overlay, as in the paper's Figures 3, 4 and 12."""


def chosen_frames(psnr: Mapping[int, float]) -> dict[str, int]:
    """Return the frame with the lowest PSNR, and the one with the median PSNR."""
    worst = min(psnr, key=lambda frame: psnr[frame])
    middle = statistics.median_low(psnr.values())
    return {"worst": worst, "median": next(frame for frame, value in psnr.items() if value == middle)}


def image_file(folder: Path, kind: str, camera: str) -> Path:
    """Return the path of an image of a camera; kind is worst, median or layers."""
    return folder / kind / f"{camera.replace('/', '_')}.png"


def write_images(
    folder: Path,
    timeline: Timeline,
    capture: Capture,
    psnr: Mapping[str, Mapping[int, float]],
) -> None:
    """Write truth, render and error of the worst and the median frame of each camera, and the layers of the worst frame.

    `folder`: Folder of the images.
    """
    for name, by_frame in psnr.items():
        view = capture.camera(name)
        for kind, frame in chosen_frames(by_frame).items():
            truth = capture.read(frame, 1, [name])[0, 0].astype(np.float32) / 255
            moment = timeline.at(frame / timeline.fps)
            render = np.clip(timeline.render(moment, view), 0, 1)
            write_png(image_file(folder, kind, name), comparison(truth, render))
            if kind == "worst":
                write_png(image_file(folder, "layers", name), layers_overlay(timeline, moment, view, render))


def layers_overlay(timeline: Timeline, moment: Moment, view: Camera, render: np.ndarray) -> np.ndarray:
    """Return the layers of a moment, uint8 [H, W, 3]: moving points in blue, static ones in gray as bright as the render."""
    manifest = timeline.manifest
    sh = np.where(moment.is_static[:, None, None], -0.5, 0.5) / C0 * np.ones((1, 1, 3))  # a color is 0.5 + C0 * sh
    labels = Gaussians(moment.means, moment.quats, moment.scales, moment.opacities, sh)
    drawn = labels[~(moment.is_static & manifest.clearance.hides(moment.means, view))]
    image = draw_on_cpu(drawn, view, manifest.near, manifest.antialias, (0.0, 0.0, 0.0))
    moving = np.clip(image, 0, 1).mean(-1, keepdims=True)
    gray = render.mean(-1, keepdims=True)
    static = 0.35 + 0.65 * gray
    overlay = (1 - moving) * static + moving * (0.35 * gray + 0.65 * BLUE)
    return (np.clip(overlay, 0, 1) * 255 + 0.5).astype(np.uint8)


def comparison(truth: np.ndarray, render: np.ndarray) -> np.ndarray:
    """Return truth, render and amplified absolute error side by side, uint8 [H, 3 W, 3]. Inputs are float images [H, W, 3] 0..1."""
    error = np.abs(truth - render) * _ERROR_GAIN
    strip = np.concatenate([truth, render, error], axis=1)
    return (np.clip(strip, 0, 1) * 255 + 0.5).astype(np.uint8)


def write_png(path: Path, image: np.ndarray) -> None:
    """Write a uint8 image [H, W, 3] atomically."""
    write_bytes(path, encode_image(image, ".png"))
