"""Calibrated cameras of other programs, before they are paired with images."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import numbers, parse_xml, read_file
from splatreel.capture.pose_checks import check_rotation
from splatreel.capture.readers.colmap_model import import_pycolmap


@dataclass
class BrownLens:
    """Lens with the interface of a pycolmap.Camera that `undistorted_camera` uses.

    Attributes:
        pinhole: fx, fy, cx, cy in pixels.
        radial: k1, k2, k3, k4, of the second to the eighth power of the radius.
        tangential: p1, p2 in OpenCV's order.
        skew: Element K[0, 1] in pixels.
    """

    width: int
    height: int
    pinhole: tuple[float, ...]
    radial: tuple[float, ...]
    tangential: tuple[float, ...]
    skew: float

    @property
    def model(self) -> SimpleNamespace:
        """Model with its name."""
        return SimpleNamespace(name="BROWN")

    @property
    def params(self) -> list[float]:
        """All parameters, for messages."""
        return [*self.pinhole, *self.radial, *self.tangential, self.skew]

    def mean_focal_length(self) -> float:
        """Return the mean of both focal lengths."""
        return (self.pinhole[0] + self.pinhole[1]) / 2

    def img_from_cam(self, rays: np.ndarray) -> np.ndarray:
        """Project points [N, 3] in front of the camera to pixels, [N, 2]."""
        x, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
        square = x * x + y * y
        k1, k2, k3, k4 = self.radial
        p1, p2 = self.tangential
        stretch = 1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))
        bent_x = x * stretch + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        bent_y = y * stretch + p1 * (square + 2 * y * y) + 2 * p2 * x * y
        fx, fy, cx, cy = self.pinhole
        return np.stack([fx * bent_x + self.skew * bent_y + cx, fy * bent_y + cy], 1)


CALIBRATION_BYTES = 64 << 20
"""Maximum size of a calibration file."""
SKEW = 1e-2
"""Maximum skew, relative to the focal length. Cameras have none."""
OPENCV_COEFFICIENTS = 8
"""Number of OpenCV's coefficients k1, k2, p1, p2, k3, k4, k5, k6. The further ones tilt the lens."""
FISHEYE_COEFFICIENTS = 4
"""Number of coefficients k1, k2, k3, k4 of OpenCV's fisheye model."""
OPENCV_CENTER = 0.5
"""Coordinate of the center of the first pixel minus that of OpenCV, which counts pixel centers from 0."""


@dataclass(frozen=True)
class RigCamera:
    """Camera of a calibration.

    Attributes:
        viewmat: World to camera in OpenCV's axes, [4, 4] float64.
        size: Width and height of the calibrated image, in pixels, or None if the format does not state them.
        lens: Function from the width and height of the images to the lens, a pycolmap.Camera or `BrownLens`.
    """

    name: str
    viewmat: np.ndarray
    size: tuple[int, int] | None
    lens: Callable[[int, int], Any]


@dataclass(frozen=True)
class Rig:
    """Content of a calibration.

    Attributes:
        origin: File or folder of the calibration.
        points: Sparse points, [P, 3] float32, or None.
        point_colors: Their colors, [P, 3] float32 0..1, or None.
        held_out: Cameras that the format holds out, or None.
        notes: Sentences about what was left out.
        partial: True if images of some cameras are commonly missing.
    """

    origin: Path
    cameras: list[RigCamera]
    points: np.ndarray | None = None
    point_colors: np.ndarray | None = None
    held_out: list[str] | None = None
    notes: list[str] = field(default_factory=list)
    partial: bool = False

    def names(self) -> list[str]:
        """Return the names of the cameras."""
        return [camera.name for camera in self.cameras]


@contextmanager
def naming(whose: str) -> Iterator[None]:
    """Turn errors of missing or wrong values into a `CaptureError` that starts with `whose`."""
    try:
        yield
    except KeyError as error:
        raise CaptureError(f"{whose}: has no {error.args[0]!r}. Export the calibration again.") from error
    except (ValueError, TypeError, AttributeError, IndexError, OverflowError) as error:
        raise CaptureError(f"{whose}: cannot be read ({error}). Export the calibration again.") from error


def read_text(file: Path) -> str:
    """Return the text of a calibration file."""
    data = read_file(file, CALIBRATION_BYTES, CaptureError)
    with naming(str(file)):
        return data.decode("utf-8-sig")


def read_xml(file: Path) -> Element:
    """Return the root of an XML file."""
    return parse_xml(
        read_text(file), lambda problem: CaptureError(f"{problem} Export the calibration again."), f"{file}:"
    )


def floats(text: str | None, count: int) -> np.ndarray:
    """Return numbers separated by blanks, [count]. Raise ValueError for anything else."""
    values = np.array((text or "").split(), np.float64)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise ValueError(f"{(text or 'nothing')!r:.80} is not {count} numbers")
    return values


def pose(whose: str, rotation: Any, translation: Any) -> np.ndarray:
    """Return world to camera, [4, 4], from a rotation [3, 3] or a rotation vector [3] and a translation [3]."""
    with naming(whose):
        values = np.asarray(rotation, np.float64)
        turn = numbers(values.ravel().tolist(), 9 if values.size == 9 else 3)
        shift = numbers(np.asarray(translation, np.float64).ravel().tolist(), 3)
    matrix = turn.reshape(3, 3) if turn.size == 9 else Rotation.from_rotvec(turn).as_matrix()
    check_rotation(matrix, f"{whose}: its rotation")
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = matrix, shift
    return viewmat


def image_size(values: Any) -> tuple[int, int]:
    """Return width and height. Raise ValueError unless both are positive numbers."""
    width, height = numbers(list(values), 2)
    if min(width, height) < 1 or max(width, height) > 1 << 20:
        raise ValueError(f"{width:g} x {height:g} is not the size of an image")
    return round(width), round(height)


def opencv_lens(whose: str, K: Any, distortions: Any, size: tuple[int, int], fisheye: bool = False) -> Any:
    """Return a lens of OpenCV's as a pycolmap.Camera.

    Args:
        whose: Origin of the lens, for messages.
        K: Intrinsic matrix [3, 3]. The center of the first pixel is at (0, 0), as in OpenCV.
        distortions: Coefficients in OpenCV's order.
        size: Width and height in pixels.
        fisheye: True for `cv2.fisheye`.
    """
    with naming(whose):
        matrix = numbers(np.asarray(K, np.float64).tolist(), 3, 3)
        flat = np.asarray(distortions, np.float64).ravel()
        values = numbers(flat.tolist(), len(flat))
    if min(matrix[0, 0], matrix[1, 1]) <= 0 or abs(matrix[0, 1]) > SKEW * matrix[0, 0]:
        raise CaptureError(
            f"{whose}: its matrix is {matrix.tolist()}; focal lengths must be positive and the skew 0. Calibrate it again."
        )
    known = FISHEYE_COEFFICIENTS if fisheye else OPENCV_COEFFICIENTS
    if np.abs(values[known:]).max(initial=0) > 0:
        raise CaptureError(
            f"{whose}: has {len(values)} distortion coefficients ({values.tolist()}), of which {known} are supported. Calibrate it "
            f"with a model without thin prisms and tilt."
        )
    pinhole = [matrix[0, 0], matrix[1, 1], matrix[0, 2] + OPENCV_CENTER, matrix[1, 2] + OPENCV_CENTER]
    padded = np.pad(values[:known], (0, known - len(values[:known]))).tolist()
    model = "OPENCV_FISHEYE" if fisheye else "FULL_OPENCV"
    return import_pycolmap().Camera(model=model, width=size[0], height=size[1], params=[*pinhole, *padded])


def brown_lens(
    whose: str,
    size: tuple[int, int],
    pinhole: list[float],
    radial: list[float],
    tangential: list[float],
    skew: float = 0,
) -> Any:
    """Return a lens of Brown's model with up to four radial coefficients.

    Args:
        whose: Origin of the lens, for messages.
        size: Width and height in pixels.
        pinhole: fx, fy, cx, cy in pixels; the center of the first pixel is at (0.5, 0.5).
        radial: k1, k2, k3, k4.
        tangential: p1, p2 in OpenCV's order.
        skew: Element K[0, 1] in pixels.

    Returns:
        A pycolmap.Camera, or a `BrownLens` with k4 or skew, which no model of COLMAP has.
    """
    width, height = size
    if not np.isfinite([*pinhole, *radial, *tangential, skew]).all() or min(pinhole[:2]) <= 0:
        raise CaptureError(
            f"{whose}: has the lens {[*pinhole, *radial, *tangential, skew]}; all must be finite, and the focal lengths positive. "
            f"Calibrate it again."
        )
    if radial[3] or skew:
        return BrownLens(width, height, tuple(pinhole), tuple(radial), tuple(tangential), skew)
    params = [*pinhole, *radial[:2], *tangential, radial[2], 0, 0, 0]
    return import_pycolmap().Camera(model="FULL_OPENCV", width=width, height=height, params=params)
