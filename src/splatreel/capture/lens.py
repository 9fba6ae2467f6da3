"""Removal of lens distortion: images are resampled for a pinhole camera of any size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from splatreel.base.command_line import install_command
from splatreel.base.errors import CaptureError, MissingDependencyError
from splatreel.scene.camera import Camera

FOCAL_LENGTHS = {"SIMPLE_PINHOLE": 1, "PINHOLE": 2, "SIMPLE_RADIAL": 1, "RADIAL": 1, "OPENCV": 2, "FULL_OPENCV": 2}
"""Camera models that are pinholes with zero distortion, and their number of focal lengths."""
SAME_SHAPE = 0.01
"""Maximum relative difference of aspect ratios without cropping."""
BORDER = 64
"""Points per image side that must lie within the lens's image."""
NARROWER = 1.005
"""Factor between tried focal lengths."""
LONGEST = 8.0
"""Maximum tried focal length, in units of the lens's own."""
CROPPED = 0.02
"""Share of an image's pixels up to which a crop is not reported."""
MOST_NAMED = 4
"""Maximum number of cameras that a sentence lists."""

Size = tuple[int, int]
"""Width and height in pixels."""


@dataclass(frozen=True)
class Lens:
    """Resampling from a lens's image to a pinhole camera's image.

    Attributes:
        width: Width at which to read the lens's image.
        height: Height at which to read the lens's image. The resolution is about that of the output.
        places: Pixel of the lens's image for each output pixel, [H, W, 2] float32; pixel centers are integers.
        keeps_shape: True if the output has the aspect ratio of the lens's image.
        shown: Share of the area of the lens's image that the output shows, 0..1.
    """

    width: int
    height: int
    places: np.ndarray
    keeps_shape: bool
    shown: float

    def undistort(self, image: np.ndarray) -> np.ndarray:
        """Convert an image [height, width, 3] uint8 of the lens to [H, W, 3] of the pinhole camera."""
        cv2 = import_cv2("Straightening images")
        return cv2.remap(image, self.places, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def undistorted_camera(
    name: str, viewmat: np.ndarray, lens: Any, width: int, height: int, origin: str
) -> tuple[Camera, Lens | None]:
    """Return a camera at the output size, and its lens unless resizing is enough.

    Args:
        name: Name of the camera.
        viewmat: World to camera, [4, 4].
        lens: A pycolmap.Camera.
        width: Output width.
        height: Output height.
        origin: Origin of the lens, for the message.

    Raises:
        CaptureError: The lens cannot be undistorted.
    """
    if _is_pinhole(lens) and _is_same_shape((lens.width, lens.height), (width, height)):
        K = np.asarray(lens.calibration_matrix())
        return Camera(name, viewmat, K, lens.width, lens.height).resized(width, height), None
    found = _pinhole(name, viewmat, lens, width, height)
    if found is None:
        raise CaptureError(
            f"{origin} is {lens.model.name} with parameters {np.asarray(lens.params).tolist()}, which "
            f"cannot be undistorted. Calibrate it again."
        )
    return found


def fitted_camera(camera: Camera, width: int, height: int) -> tuple[Camera, Lens | None]:
    """Return an undistorted camera at the output size, and the crop of its images if they have another shape."""
    if _is_same_shape((camera.width, camera.height), (width, height)):
        return camera.resized(width, height), None
    lens: Any = _PinholeLens(camera.width, camera.height, camera.K.astype(np.float64))
    return undistorted_camera(camera.name, camera.viewmat, lens, width, height, f"camera {camera.name}")


def common_size(sizes: Sequence[Size]) -> Size:
    """Return the most common size among those of the most common shape.

    Of equally common shapes, the one is taken whose cropping loses the fewest pixels of the other images.
    """
    counts = Counter(sizes)
    shapes = {size: [other for other in sizes if _is_same_shape(size, other)] for size in counts}
    return max(counts, key=lambda size: (len(shapes[size]), sum(_shown(size, other) for other in sizes), counts[size]))


def describe_crops(lenses: Mapping[str, Lens]) -> list[str]:
    """Return sentences about the cameras whose images lose more than `CROPPED` of their pixels."""
    lost = {name: 1 - lens.shown for name, lens in lenses.items() if 1 - lens.shown > CROPPED}
    found = []
    for keeps in (False, True):
        names = sorted((n for n in lost if lenses[n].keeps_shape == keeps), key=lambda n: -lost[n])
        if not names:
            continue
        height, width = lenses[names[0]].places.shape[:2]
        reason = (
            "to remove the lens distortion without empty borders"
            if keeps
            else f"to the shape of most cameras' images ({width}x{height})"
        )
        listed = ", ".join(f"{name} by {100 * lost[name]:.0f} %" for name in names[:MOST_NAMED])
        more = f" and {len(names) - MOST_NAMED} more cameras by less" if len(names) > MOST_NAMED else ""
        found.append(f"images are cropped {reason}: {listed}{more}")
    return found


def _is_same_shape(one: Size, other: Size) -> bool:
    return abs(one[0] / one[1] * other[1] / other[0] - 1) <= SAME_SHAPE


def _shown(size: Size, image: Size) -> float:
    """Return the share of an image that its largest part with the shape of `size` shows."""
    ratio = size[0] / size[1] * image[1] / image[0]
    return min(ratio, 1 / ratio)


@dataclass(frozen=True)
class _PinholeLens:
    """Lens without distortion, with the interface of a pycolmap.Camera."""

    width: int
    height: int
    K: np.ndarray
    model = SimpleNamespace(name="undistorted")

    @property
    def params(self) -> list[float]:
        return self.K.ravel().tolist()

    def mean_focal_length(self) -> float:
        return float(self.K[0, 0] + self.K[1, 1]) / 2

    def img_from_cam(self, rays: np.ndarray) -> np.ndarray:
        pixels = rays @ self.K.T
        return pixels[:, :2] / pixels[:, 2:]


def _is_pinhole(lens: Any) -> bool:
    focal_lengths = FOCAL_LENGTHS.get(lens.model.name)
    return focal_lengths is not None and np.abs(lens.params[focal_lengths + 2 :]).max(initial=0) <= 1e-9


def _pinhole(name: str, viewmat: np.ndarray, lens: Any, width: int, height: int) -> tuple[Camera, Lens] | None:
    """Return the pinhole camera that shows the most of a lens without showing its borders, and the resampling.

    None if no such camera exists, which means that the model is not a lens.
    """
    focal = _focal(lens, width, height)
    if focal is None:
        return None
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    places = _project(lens, focal, width, height, np.stack([x.ravel(), y.ravel()], 1))
    finer = min(focal / lens.mean_focal_length(), 1.0)
    size = max(round(lens.width * finer), 1), max(round(lens.height * finer), 1)
    places = places * (size[0] / lens.width, size[1] / lens.height) - 0.5
    shown = min(_area(_project(lens, focal, width, height, _border(width, height))) / (lens.width * lens.height), 1.0)
    keeps_shape = _is_same_shape((lens.width, lens.height), (width, height))
    resampling = Lens(*size, places.reshape(height, width, 2).astype(np.float32), keeps_shape, shown)
    return Camera(name, viewmat, K, width, height), resampling


def _focal(lens: Any, width: int, height: int) -> float | None:
    """Return the shortest focal length at which the image border lies within the lens's image, searched from long to short."""
    border = _border(width, height)
    found, scale = None, max(width / lens.width, height / lens.height) * lens.mean_focal_length()
    for focal in LONGEST * scale * NARROWER ** -np.arange(1000.0):
        places = _project(lens, focal, width, height, border)
        if not ((places >= -1e-6) & (places <= (lens.width + 1e-6, lens.height + 1e-6))).all():
            return found
        found = float(focal)
    return None


def _border(width: int, height: int) -> np.ndarray:
    along = np.linspace(0, 1, BORDER)
    zeros, ones = np.zeros(BORDER), np.ones(BORDER)
    sides = (along, zeros), (ones, along), (along[::-1], ones), (zeros, along[::-1])
    return np.concatenate([np.stack(side, 1) for side in sides]) * (width, height)


def _area(outline: np.ndarray) -> float:
    x, y = outline.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def _project(lens: Any, focal: float, width: int, height: int, pixels: np.ndarray) -> np.ndarray:
    """Project pixels [N, 2] of a pinhole camera into the lens's image, [N, 2]; NaN outside of it."""
    rays = np.concatenate([(pixels - (width / 2, height / 2)) / focal, np.ones((len(pixels), 1))], 1)
    return np.asarray(lens.img_from_cam(rays), np.float64).reshape(-1, 2)


def import_cv2(purpose: str) -> Any:
    """Return the module cv2. Raise `MissingDependencyError` if it is not installed. `purpose` starts the message."""
    try:
        import cv2
    except ImportError as error:
        raise MissingDependencyError(f"{purpose} needs OpenCV. Run\n  {install_command('recon')}") from error
    return cv2
