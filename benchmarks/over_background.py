"""Draw the reel of a subject over the backgrounds of cameras, and compare it with their images.

`evaluate` compares within masks over black, where the image shows the background in border pixels. Over the background itself, these
pixels have one truth. It is found in the camera's own video, in pixels that the masks do not cover.

python benchmarks/over_background.py REEL CAPTURE MASKS --cameras 18,22,28,25
"""

from pathlib import Path

import cv2
import numpy as np
import tyro
from tyro.conf import Positional

from record import record
from splatreel.capture.masks import MaskedCapture
from splatreel.capture.opening import open_capture
from splatreel.codec.reader import ReelReader
from splatreel.evaluation.metrics import psnr
from splatreel.kernels.image import render_image
from splatreel.play.timeline import Timeline
from splatreel.scene.camera import Camera
from splatreel.segmentation.background import fit_background
from splatreel.segmentation.mask_writer import sample_moments

AROUND, CLEAR = 3, 5
"""Largest distance of compared pixels from the masks, and smallest distance of pixels that show the background for sure, pixels."""


def main(
    reel: Positional[Path],
    capture: Positional[Path],
    masks: Positional[Path],
    /,
    cameras: str,
    width: int = 320,
    note: str = "",
) -> None:
    """Draw, compare, record.

    Args:
        reel: The reel.
        capture: Its capture. The first frame of the reel is the first one of the capture.
        masks: Folder of masks of the cameras in all frames.
        cameras: Names of the cameras to compare with, as NAME,NAME.
        width: Width of the images in pixels.
        note: Note of the record.
    """
    everything = open_capture(capture, width=width)
    others = [camera.name for camera in everything.cameras if camera.name not in cameras.split(",")]
    everything.close()
    source = open_capture(capture, width=width, held_out=[], leave_out=others, masks=masks)
    assert isinstance(source, MaskedCapture)
    names = [camera.name for camera in source.cameras]
    timeline = Timeline(ReelReader(reel))
    frames = range(min(timeline.reel.frames, source.frames))
    moments = sample_moments(source.frames)
    film = np.stack([source.scene.read(t, 1, names)[0] for t in moments])
    shown = np.stack([source.alpha(t, 1, names)[0] for t in moments])
    scores: dict[str, list[float]] = {"near": [], "border": [], "inner": []}
    for c, camera in enumerate(source.cameras):
        certain = np.stack([1 - grown(mask > 0, CLEAR) for mask in shown[:, c]]).astype(np.float32)
        background = fit_background(film[:, c], certain)
        for frame in frames:
            image = source.scene.read(frame, 1, [camera.name])[0, 0]
            drawn = draw_over(timeline, frame, camera, background.lit(image) / 255)
            mask = source.alpha(frame, 1, [camera.name])[0, 0] > 127
            usable = background.known | mask
            pixels = {
                "near": grown(mask, AROUND) & usable,
                "border": grown(mask, 1) & grown(~mask, 1) & usable,
                "inner": ~grown(~mask, 2),
            }
            for name, within in pixels.items():
                if within.any():
                    scores[name].append(psnr(drawn, image / np.float32(255), within))
    source.close()
    values = {
        "capture": capture.name,
        "cameras": names,
        "trained_on": [camera.name for camera in timeline.manifest.cameras],
        "frames": len(frames),
        "width": width,
        **{f"psnr_{name}": float(np.mean(found)) for name, found in scores.items()},
    }
    print(record("over background", values, note))


def grown(mask: np.ndarray, pixels: int) -> np.ndarray:
    """Return a mask [H, W] bool that is wider by some pixels."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=pixels) > 0


def draw_over(timeline: Timeline, frame: int, camera: Camera, behind: np.ndarray) -> np.ndarray:
    """Return a frame of a reel over a background [H, W, 3], 0..1."""
    gaussians, manifest = timeline.at(frame / timeline.fps), timeline.manifest
    seen = timeline.seen(gaussians, camera)
    black, white = (
        render_image(seen, camera, near=manifest.near, antialias=manifest.antialias, background=(level, level, level))
        for level in (0, 1)
    )
    return (black + (white - black) * behind).clip(0, 1).astype(np.float32)


if __name__ == "__main__":
    tyro.cli(main)
