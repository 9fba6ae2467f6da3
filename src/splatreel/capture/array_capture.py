"""A capture of images that a program holds in memory."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.base import Capture
from splatreel.scene.camera import Camera

UNEVEN = 0.05
"""Largest difference of a time from an even rate, in frames."""


class ArrayCapture(Capture):
    """Capture of images in memory. `capture_from_arrays` makes one."""

    def __init__(
        self,
        images: np.ndarray,
        cameras: Sequence[Camera],
        *,
        fps: float,
        held_out: Sequence[str],
        points: np.ndarray | None,
        point_colors: np.ndarray | None,
        name: str,
    ) -> None:
        """Make a capture of images [T, C, H, W, 3] uint8 in the order of the cameras."""
        self._images = images
        super().__init__(
            *(Path(name), list(cameras)),
            held_out=list(held_out),
            frame_range=(0, len(images)),
            fps=fps,
            points=points,
            point_colors=point_colors,
        )

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        numbers = {camera.name: number for number, camera in enumerate(self.cameras)}
        for place, name in enumerate(cameras):
            out[:, place] = self._images[first : first + len(out), numbers[name]]

    @cached_property
    def _digest(self) -> bytes:
        digest = hashlib.sha256()
        for frame in self._images:
            digest.update(frame.tobytes())
        return digest.digest()

    def fingerprint(self) -> str:
        """Return a short string that changes with the cameras, the frames, the held-out cameras or the images."""
        return hashlib.sha256(super().fingerprint().encode() + self._digest).hexdigest()[:16]


def capture_from_arrays(
    images: np.ndarray,
    cameras: Sequence[Camera],
    times: Sequence[float] | np.ndarray | None = None,
    *,
    fps: float = 30.0,
    held_out: Sequence[str] = (),
    points: np.ndarray | None = None,
    point_colors: np.ndarray | None = None,
    name: str = "arrays",
) -> Capture:
    """Make a capture of images in memory, for `reconstruct` and `evaluate`.

    Args:
        images: Images in sRGB, [T, C, H, W, 3], uint8 or floats 0..1. The second axis has the order of `cameras`. Uint8 arrays, and
            memory maps of them, are not copied.
        cameras: Cameras of the size of the images.
        times: Seconds of the T frames, evenly spaced; None uses `fps`.
        fps: Frames per second, without `times` or with a single frame.
        held_out: Names of the cameras that are not trained on.
        points: Sparse points of the first frame, [P, 3]; None if there are none.
        point_colors: Their colors, [P, 3], 0..1.
        name: Name of the capture, for messages and for the record of the run.

    Raises:
        CaptureError: Shapes, values or times do not fit, or the cameras cannot be used.
    """
    array = image_array(images, cameras, name)
    return ArrayCapture(
        *(array, cameras),
        fps=fps if times is None else _rate(np.asarray(times, np.float64), len(array), fps, name),
        held_out=held_out,
        points=None if points is None else np.asarray(points, np.float32),
        point_colors=None if point_colors is None else np.asarray(point_colors, np.float32),
        name=name,
    )


def image_array(images: np.ndarray, cameras: Sequence[Camera], name: str) -> np.ndarray:
    """Return images [T, C, H, W, 3] as uint8. Those that are uint8 already are not copied.

    Args:
        images: Images in sRGB, uint8 or floats 0..1, in the order of the cameras.
        cameras: Cameras of the size of the images.
        name: Name of the images, for messages.

    Raises:
        CaptureError: Shapes or values do not fit.
    """
    try:
        array = np.asarray(images)
    except (ValueError, TypeError) as error:  # rows of different lengths, or tensors on a GPU
        raise CaptureError(
            f"{name}: the images are not an array ({error}). Give [T, C, H, W, 3] in main memory."
        ) from error
    if array.ndim != 5 or array.shape[-1] != 3 or array.shape[1] != len(cameras) or not array.size:
        raise CaptureError(
            f"{name}: images have shape {array.shape}, expected [T, {len(cameras)}, H, W, 3] for {len(cameras)} cameras."
        )
    height, width = array.shape[2:4]
    for camera in cameras:
        if (camera.width, camera.height) != (width, height):
            raise CaptureError(
                f"{name}: the images are {width}x{height}, and camera {camera.name!r} is {camera.width}x{camera.height}. "
                f"Give each camera the size of the images, such as camera.resized({width}, {height})."
            )
    return _as_bytes(array, name)


def _as_bytes(images: np.ndarray, name: str) -> np.ndarray:
    """Return images as uint8. Raise `CaptureError` for floats outside of 0..1 and for other types."""
    if images.dtype == np.uint8:
        return images
    if images.dtype.kind != "f":
        raise CaptureError(f"{name}: images are of type {images.dtype}. Give uint8, or floats 0..1.")
    out = np.empty(images.shape, np.uint8)
    for frame, image in enumerate(images):
        low, high = float(image.min()), float(image.max())
        if not (low >= 0 and high <= 1):
            raise CaptureError(
                f"{name}: frame {frame} has values from {low:g} to {high:g}. Give uint8, or floats 0..1."
            )
        out[frame] = np.rint(image * 255)
    return out


def _rate(times: np.ndarray, frames: int, fps: float, name: str) -> float:
    """Return the frames per second of evenly spaced times. Raise `CaptureError` for other times."""
    if times.shape != (frames,) or not np.isfinite(times).all():
        raise CaptureError(
            f"{name}: times have shape {times.shape}, expected one finite number for each of {frames} frames."
        )
    if frames == 1:
        return fps
    gap = (times[-1] - times[0]) / (frames - 1)
    late = np.abs(times - times[0] - gap * np.arange(frames))
    if gap <= 0 or late.max() > UNEVEN * gap:
        worst = int(late.argmax())
        raise CaptureError(
            f"{name}: frames must be evenly spaced in time. Frame {worst} is at {times[worst]:g} s, and {gap:g} s between two frames "
            f"would have it at {times[0] + gap * worst:g} s. Choose or interpolate frames of one rate."
        )
    return float(1 / gap)
