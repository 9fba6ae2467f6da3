"""Crops of renders beside the truth: where to crop, by the error of the renders, and the strip of a figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import uniform_filter

from splatreel.capture.base import Capture
from splatreel.play.timeline import Timeline
from splatreel.scene.camera import Camera

SIDE = 192
"""Width and height of a crop in a figure, in pixels."""
SHARE = 0.3
"""Side of a crop as a share of the image's height."""
CANDIDATES = 8
"""Frames at which crops are looked for, evenly spread."""
LABEL = 16
"""Height of the line of text above a crop, in pixels."""

Render = Callable[[int, Camera], np.ndarray]
"""Function from a frame and a camera to an image [H, W, 3] float32 0..1."""
Weight = Callable[[Capture, int, str], np.ndarray]
"""Function from a capture, a frame and a camera to the weight [H, W] of the error of each pixel."""


@dataclass(frozen=True)
class Crop:
    """Square part of an image of a capture.

    Attributes:
        camera: Name of the camera.
        frame: Number of the frame.
        top: First row.
        left: First column.
        side: Number of rows and columns.
    """

    camera: str
    frame: int
    top: int
    left: int
    side: int

    def of(self, image: np.ndarray) -> np.ndarray:
        """Return the part of an image [H, W, 3]."""
        return image[self.top : self.top + self.side, self.left : self.left + self.side]


def truth_of(capture: Capture, frame: int, camera: str) -> np.ndarray:
    """Return an image of a camera, [H, W, 3] float32 0..1."""
    return capture.read(frame, 1, [camera])[0, 0].astype(np.float32) / 255


def fast(capture: Capture, frame: int, camera: str) -> np.ndarray:
    """Weigh pixels by their change since the frame before: fast motion."""
    return np.abs(truth_of(capture, frame, camera) - truth_of(capture, frame - 1, camera)).mean(-1)


def new(capture: Capture, frame: int, camera: str) -> np.ndarray:
    """Weigh pixels by their difference from the first frame: content that has appeared."""
    return np.abs(truth_of(capture, frame, camera) - truth_of(capture, 0, camera)).mean(-1)


def anywhere(capture: Capture, frame: int, camera: str) -> np.ndarray:
    """Weigh all pixels alike."""
    return np.ones((capture.height, capture.width), np.float32)


def renderer(timeline: Timeline) -> Render:
    """Return the function that renders a reel."""
    return lambda frame, camera: np.clip(timeline.render(timeline.at(frame / timeline.fps), camera), 0, 1)


def find_crop(
    capture: Capture,
    renders: Sequence[Render],
    weight: Weight,
    frames: Sequence[int] | None = None,
    reference: Render | None = None,
) -> Crop | None:
    """Return the crop with the largest weighted error, summed over the renders; None if all weights are 0.

    Args:
        capture: Capture with held-out cameras.
        renders: Renders that are compared.
        weight: Weight of each pixel.
        frames: Frames to look at; None looks at `CANDIDATES` frames after the first.
        reference: Render that errors are measured against; None measures them against the truth.
    """
    side = min(max(round(SHARE * capture.height), 8), capture.width, capture.height)
    if frames is None:
        last = capture.frames - 1
        frames = sorted(set(np.linspace(min(1, last), last, CANDIDATES).round().astype(int).tolist()) - {0})
    best, found = 0.0, None
    for frame in frames:
        for name in capture.held_out:
            weights, view = weight(capture, frame, name), capture.camera(name)
            truth = truth_of(capture, frame, name) if reference is None else reference(frame, view)
            errors = sum(np.abs(render(frame, view) - truth).mean(-1) for render in renders)
            sums = uniform_filter(errors * weights, side, mode="constant")
            half = side // 2
            inside = sums[half : half + capture.height - side + 1, half : half + capture.width - side + 1]
            top, left = np.unravel_index(int(inside.argmax()), inside.shape)
            if inside[top, left] > best:
                best, found = float(inside[top, left]), Crop(name, frame, int(top), int(left), side)
    return found


def strip(crops: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return crops side by side with their names above them, uint8 [LABEL + SIDE, count * SIDE, 3].

    Args:
        crops: Images [side, side, 3], uint8, or float32 0..1, by name.
    """
    sheet = Image.new("RGB", (SIDE * len(crops), LABEL + SIDE), "white")
    draw = ImageDraw.Draw(sheet)
    for column, (name, crop) in enumerate(crops.items()):
        pixels = crop if crop.dtype == np.uint8 else (np.clip(crop, 0, 1) * 255 + 0.5).astype(np.uint8)
        large = Image.fromarray(pixels).resize((SIDE, SIDE), Image.Resampling.NEAREST)
        sheet.paste(large, (column * SIDE, LABEL))
        draw.text((column * SIDE + 3, 2), name, fill="black")
    return np.asarray(sheet)
