"""A capture of images that a program holds in memory."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.base import Capture
from splatreel.capture.pose_checks import NEEDED, check_center, look_inverted, validate_poses
from splatreel.scene.camera import Camera

UNEVEN = 0.05
"""Largest difference of a time from an even rate, in frames."""
SLOW = 2.0
"""Seconds between two frames from which times are taken for another unit."""
UNITS = {1e3: "milliseconds", 1e6: "microseconds", float("inf"): "nanoseconds"}
"""Units of such times, each with the longest step that is plausible in it."""
FIELD = 0.5, 170.0
"""Plausible fields of view along the width, degrees."""
CENTERED = 0.1
"""Largest usual distance of a principal point from the center, as a share of the width and height."""
SAME_SHARE = 0.03
"""Tolerance of two shares of a principal point, at which the size that K belongs to has the images' aspect ratio."""


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
    check_lenses(cameras, name)
    points, point_colors = point_arrays(points, point_colors, name)
    rate = fps if times is None else _rate(times, len(array), fps, name)
    if not 0 < rate < np.inf:
        raise CaptureError(f"{name}: fps is {rate:g}. Give the number of frames per second.")
    return ArrayCapture(
        *(array, cameras),
        fps=rate,
        held_out=[held_out] if isinstance(held_out, str) else held_out,
        points=points,
        point_colors=point_colors,
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
    if wrong := [camera for camera in cameras if not isinstance(camera, Camera)]:
        raise CaptureError(f"{name}: a camera is of type {type(wrong[0]).__name__}. Give splatreel.Camera objects.")
    if array.ndim != 5 or array.shape[-1] != 3 or array.shape[1] != len(cameras) or not array.size:
        raise CaptureError(
            f"{name}: images have shape {array.shape}, expected [T, {len(cameras)}, H, W, 3] for {len(cameras)} cameras."
            f"{_shape_remedy(array.shape, len(cameras))}"
        )
    height, width = array.shape[2:4]
    for camera in cameras:
        if (camera.width, camera.height) != (width, height):
            raise CaptureError(
                f"{name}: the images are {width}x{height}, and camera {camera.name!r} is {camera.width}x{camera.height}. "
                f"Give each camera the size of the images, such as camera.resized({width}, {height})."
            )
    return _as_bytes(array, name)


def _shape_remedy(shape: tuple[int, ...], cameras: int) -> str:
    """Return the remedy for images of a usual other shape, with a space before it; empty for others."""
    if len(shape) != 5:
        return ""
    if shape[1] == cameras and shape[-1] == 4:
        return " Leave out the alpha channel: images[..., :3]."
    if shape[1] == cameras and shape[2] == 3:
        return " Colors come last: np.moveaxis(images, 2, -1)."
    if shape[0] == cameras and shape[-1] == 3:
        return " Frames come first: np.swapaxes(images, 0, 1)."
    return ""


def check_lenses(cameras: Sequence[Camera], name: str) -> None:
    """Raise `CaptureError` if matrices K are not in pixels of the images.

    Args:
        cameras: Cameras of the size of the images.
        name: Name of the images, for messages.
    """
    shares = np.array([[camera.K[0, 2] / camera.width, camera.K[1, 2] / camera.height] for camera in cameras])
    alike = np.abs(shares[:, 0] - shares[:, 1]) < SAME_SHARE * shares[:, 0]
    scaled = bool((alike & (np.abs(shares - 0.5).max(1) > CENTERED)).all())
    for camera in cameras:
        K, size, whose = camera.K, (camera.width, camera.height), f"{name}: camera {camera.name!r}"
        if 0 < K[0, 2] <= 1 and 0 < K[1, 2] <= 1:
            raise CaptureError(
                f"{whose}: K has the principal point {K[0, 2]:.4g}, {K[1, 2]:.4g}, as in shares of the width and height. Give K in "
                f"pixels: multiply its first row by {size[0]} and its second row by {size[1]}."
            )
        if scaled:
            other = [round(2 * float(center)) for center in K[:2, 2]]
            raise CaptureError(
                f"{whose}: K has the principal point {K[0, 2]:.4g}, {K[1, 2]:.4g}, the center of images of {other[0]}x{other[1]}, and "
                f"the images are {size[0]}x{size[1]}. Make the cameras with the size of their calibration, then resize them: "
                f"camera.resized{size}."
            )
        check_center(K, size, f"{whose}: K", "Give the K of these images")
        field = float(np.degrees(2 * np.arctan2(size[0] / 2, K[0, 0])))
        if K[0, 0] > 0 and not FIELD[0] <= field <= FIELD[1]:
            raise CaptureError(
                f"{whose}: fx is {K[0, 0]:.4g} in images {size[0]} pixels wide, a field of view of {field:.4g} degrees. Give K in "
                f"pixels of these images."
            )


def check_rig(cameras: Sequence[Camera], points: np.ndarray | None, name: str) -> None:
    """Raise `CaptureError` for lenses and poses that cannot be right, where no images are asked about them.

    Args:
        cameras: Cameras of the size of the images.
        points: Points that the cameras see, [P, 3]; None if none are known.
        name: Name of the images, for messages.
    """
    check_lenses(cameras, name)
    names = [camera.name for camera in cameras]
    if len(set(names)) < len(names):
        raise CaptureError(f"{name}: two cameras have the same name, among {', '.join(names)}.")
    validate_poses(list(cameras), points, name)
    if look_inverted(list(cameras)):
        raise CaptureError(
            f"{name}: the cameras look past each other, and at one place where each pose is inverted: they are camera to world. "
            f"{NEEDED}: np.linalg.inv(pose)."
        )


def point_arrays(
    points: np.ndarray | None, colors: np.ndarray | None, name: str
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return sparse points and their colors as float32.

    Args:
        points: [P, 3]; None if there are none.
        colors: [P, 3], 0..1; None if they have none.
        name: Name of the images, for messages.

    Raises:
        CaptureError: Shapes or values do not fit.
    """
    if points is None:
        if colors is not None:
            raise CaptureError(f"{name}: there are point_colors and no points. Give both.")
        return None, None
    positions = _rows(points, "points", name)
    if colors is None:
        return positions, None
    found = _rows(colors, "point_colors", name)
    if len(found) != len(positions):
        raise CaptureError(
            f"{name}: there are {len(positions)} points and {len(found)} point_colors. Give one color a point."
        )
    if len(found) and (found.min() < 0 or found.max() > 1 + 1e-3):
        raise CaptureError(
            f"{name}: point_colors are {found.min():.4g} to {found.max():.4g}, expected 0..1. Divide colors of 0..255 by 255."
        )
    return positions, found.clip(0, 1)


def _rows(values: np.ndarray, what: str, name: str) -> np.ndarray:
    """Return rows [P, 3] of finite numbers as float32. Raise `CaptureError` for others."""
    try:
        rows = np.asarray(values, np.float32)
    except (ValueError, TypeError) as error:
        raise CaptureError(
            f"{name}: {what} are not an array of numbers ({error}). Give [P, 3] in main memory."
        ) from error
    if rows.ndim != 2 or rows.shape[1] != 3:
        remedy = f" Transpose them: {what}.T." if rows.ndim == 2 and rows.shape[0] == 3 else ""
        remedy = f" Leave out the fourth column: {what}[:, :3]." if rows.ndim == 2 and rows.shape[1] == 4 else remedy
        raise CaptureError(f"{name}: {what} have shape {rows.shape}, expected [P, 3].{remedy}")
    if bad := int((~np.isfinite(rows).all(1)).sum()):
        raise CaptureError(f"{name}: {bad} of {len(rows)} {what} are NaN or infinite. Remove these points.")
    return rows


def _as_bytes(images: np.ndarray, name: str) -> np.ndarray:
    """Return images as uint8. Raise `CaptureError` for floats outside of 0..1 and for other types."""
    if images.dtype == np.uint8:
        if images[:: max(len(images) // 4, 1)].max() == 1:
            raise CaptureError(
                f"{name}: images are uint8 and nowhere above 1. Multiply floats 0..1 by 255 before they are converted."
            )
        return images
    if images.dtype.kind != "f":
        raise CaptureError(f"{name}: images are of type {images.dtype}. Give uint8, or floats 0..1.")
    out = np.empty(images.shape, np.uint8)
    for frame, image in enumerate(images):
        low, high = float(image.min()), float(image.max())
        if not (low >= 0 and high <= 1):
            remedy = " Convert values of 0..255: images.astype(np.uint8)." if 1 < high <= 255 and low >= 0 else ""
            raise CaptureError(
                f"{name}: frame {frame} has values from {low:g} to {high:g}. Give uint8, or floats 0..1.{remedy}"
            )
        out[frame] = np.rint(image * 255)
    return out


def _rate(times: Sequence[float] | np.ndarray, frames: int, fps: float, name: str) -> float:
    """Return the frames per second of evenly spaced times. Raise `CaptureError` for other times."""
    try:
        seconds = np.asarray(times, np.float64)
    except (ValueError, TypeError) as error:
        raise CaptureError(f"{name}: times are not numbers ({error}). Give seconds.") from error
    if seconds.shape != (frames,) or not np.isfinite(seconds).all():
        raise CaptureError(
            f"{name}: times have shape {seconds.shape}, expected one finite number for each of {frames} frames. "
            f"{int((~np.isfinite(seconds)).sum())} are NaN or infinite."
        )
    if frames == 1:
        return fps
    gap = (seconds[-1] - seconds[0]) / (frames - 1)
    late = np.abs(seconds - seconds[0] - gap * np.arange(frames))
    if np.diff(seconds).min() <= 0:
        worst = int(np.diff(seconds).argmin())
        raise CaptureError(
            f"{name}: times must rise and be evenly spaced. Frame {worst + 1} is at {seconds[worst + 1]:g} s, not after frame {worst} "
            f"at {seconds[worst]:g} s. Sort the frames by time, and leave out repeated ones."
        )
    if late.max() > UNEVEN * gap:
        worst = int(late.argmax())
        raise CaptureError(
            f"{name}: frames must be evenly spaced in time. Frame {worst} is at {seconds[worst]:g} s, and {gap:g} s between two frames "
            f"would have it at {seconds[0] + gap * worst:g} s. Choose or interpolate frames of one rate."
        )
    if gap >= SLOW:
        unit = next(unit for longest, unit in UNITS.items() if gap < longest)
        raise CaptureError(
            f"{name}: times are {gap:g} s apart, a rate of {1 / gap:.4g} frames a second. If they are {unit}, convert them to seconds. "
            f"If frames really are so far apart, leave out times and give fps={1 / gap:.4g}."
        )
    return float(1 / gap)
