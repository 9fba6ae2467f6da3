"""Removes lens distortion as pictures are read: a pinhole camera takes the lens's place, with a picture of any size and shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from splatreel.errors import CaptureError, MissingDependencyError
from splatreel.scene.camera import Camera

FOCAL_LENGTHS = {"SIMPLE_PINHOLE": 1, "PINHOLE": 2, "SIMPLE_RADIAL": 1, "RADIAL": 1, "OPENCV": 2, "FULL_OPENCV": 2}
"""Camera models that are pinholes if their distortion is zero, and how many of their parameters are focal lengths."""
SAME_SHAPE = 0.01
"""Share by which widths over heights may differ without a picture being cut."""
BORDER = 64
"""Points along each side of a picture that must lie inside of the lens's picture."""
NARROWER = 1.005
"""Factor from one focal length to the next that is tried."""
LONGEST = 8.0
"""Times the lens's own focal length: a picture cut down further than that is no picture of this lens."""


@dataclass(frozen=True)
class Lens:
    """A picture of a lens, and where it shows each pixel of the pinhole camera's.

    width, height: to read the lens's picture at, about as finely as it is wanted. places: [H, W, 2] float32 pixels in it, whose
    centers are whole numbers.
    """

    width: int
    height: int
    places: np.ndarray

    def undistort(self, picture: np.ndarray) -> np.ndarray:
        """[height, width, 3] uint8 of the lens to [H, W, 3] of the pinhole camera."""
        cv2 = import_cv2("Straightening pictures")
        return cv2.remap(picture, self.places, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def resized(
    name: str, viewmat: np.ndarray, lens: Any, width: int, height: int, origin: str
) -> tuple[Camera, Lens | None]:
    """A camera of the output size, and, where it takes more than resizing, its lens.

    lens: a pycolmap.Camera. origin: where it is from, for `CaptureError` where it is no lens that could be straightened.
    """
    if _is_pinhole(lens) and abs(lens.width / lens.height * height / width - 1) <= SAME_SHAPE:
        K = np.asarray(lens.calibration_matrix())
        return Camera(name, viewmat, K, lens.width, lens.height).resized(width, height), None
    found = _pinhole(name, viewmat, lens, width, height)
    if found is None:
        raise CaptureError(
            f"{origin} is {lens.model.name} with parameters {np.asarray(lens.params).tolist()}, which "
            f"is no lens that could be straightened. Calibrate it again."
        )
    return found


def _is_pinhole(lens: Any) -> bool:
    focal_lengths = FOCAL_LENGTHS.get(lens.model.name)
    return focal_lengths is not None and np.abs(lens.params[focal_lengths + 2 :]).max(initial=0) <= 1e-9


def _pinhole(name: str, viewmat: np.ndarray, lens: Any, width: int, height: int) -> tuple[Camera, Lens] | None:
    """The pinhole camera that sees the most of a lens without seeing past its borders, and how its pictures are made.

    None where there is no such camera: what the model says is no lens.
    """
    focal = _focal(lens, width, height)
    if focal is None:
        return None
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    places = _shown(lens, focal, width, height, np.stack([x.ravel(), y.ravel()], 1))
    finer = min(focal / lens.mean_focal_length(), 1.0)
    size = max(round(lens.width * finer), 1), max(round(lens.height * finer), 1)
    places = places * (size[0] / lens.width, size[1] / lens.height) - 0.5
    return Camera(name, viewmat, K, width, height), Lens(*size, places.reshape(height, width, 2).astype(np.float32))


def _focal(lens: Any, width: int, height: int) -> float | None:
    """The shortest focal length at which a picture's borders lie inside of the lens's, on the way from long ones."""
    along = np.linspace(0, 1, BORDER)
    ends = np.zeros(BORDER), np.ones(BORDER)
    sides = [np.stack([along, e], 1) for e in ends] + [np.stack([e, along], 1) for e in ends]
    border = np.concatenate(sides) * (width, height)
    found, scale = None, max(width / lens.width, height / lens.height) * lens.mean_focal_length()
    for focal in LONGEST * scale * NARROWER ** -np.arange(1000.0):
        places = _shown(lens, focal, width, height, border)
        if not ((places >= -1e-6) & (places <= (lens.width + 1e-6, lens.height + 1e-6))).all():
            return found
        found = float(focal)
    return None


def _shown(lens: Any, focal: float, width: int, height: int, pixels: np.ndarray) -> np.ndarray:
    """[N, 2] where the lens shows what a pinhole camera of that focal length shows at pixels [N, 2]; NaN where it does not."""
    rays = np.concatenate([(pixels - (width / 2, height / 2)) / focal, np.ones((len(pixels), 1))], 1)
    return np.asarray(lens.img_from_cam(rays), np.float64).reshape(-1, 2)


def import_cv2(purpose: str) -> Any:
    """Raises `MissingDependencyError` where OpenCV is not installed. purpose: what needs it."""
    try:
        import cv2
    except ImportError as error:
        raise MissingDependencyError(f"{purpose} needs OpenCV: pip install 'splatreel[recon]'.") from error
    return cv2
