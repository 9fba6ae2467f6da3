"""Pinhole cameras in the OpenCV convention: x right, y down, z forward, pixel centers at +0.5."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splatreel.base.errors import CaptureError


@dataclass(frozen=True)
class Camera:
    """One static, undistorted camera.

    Attributes:
        name: Unique name within a capture.
        viewmat: World to camera, [4, 4] float32.
        K: Intrinsic matrix in pixels, [3, 3] float32.
        width: Image width in pixels.
        height: Image height in pixels.
    """

    name: str
    viewmat: np.ndarray
    K: np.ndarray
    width: int
    height: int

    def __post_init__(self) -> None:
        for field, shape in (("viewmat", (4, 4)), ("K", (3, 3))):
            value = np.asarray(getattr(self, field), np.float32)
            if value.shape != shape:
                raise CaptureError(f"Camera {self.name!r}: {field} has shape {value.shape}, expected {shape}.")
            if not np.isfinite(value).all():
                raise CaptureError(f"Camera {self.name!r}: {field} holds NaN or infinity. Check the capture's poses.")
            object.__setattr__(self, field, value)

    @property
    def center(self) -> np.ndarray:
        """Optical center in world units, [3] float32."""
        return -self.viewmat[:3, :3].T @ self.viewmat[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """Unit viewing direction in world coordinates, [3] float32."""
        return self.viewmat[2, :3]

    def to_dict(self) -> dict[str, Any]:
        """Return the camera as manifests store it (docs/format.md).

        Matrices are stored row by row with the fewest digits that preserve float32. Cameras take much of a small reel.
        """
        arrays = {name: _short(getattr(self, name)) for name in ("K", "viewmat")}
        return {"name": self.name, "width": int(self.width), "height": int(self.height), **arrays}

    @staticmethod
    def from_dict(value: dict[str, Any]) -> Camera:
        """Return a camera from validated JSON. Matrices may also be lists of rows."""
        viewmat, K = np.array(value["viewmat"]).reshape(4, 4), np.array(value["K"]).reshape(3, 3)
        return Camera(value["name"], viewmat, K, value["width"], value["height"])

    def resized(self, width: int, height: int) -> Camera:
        """Return the camera with its image resampled to width x height pixels."""
        K = self.K.copy()
        K[0] *= width / self.width
        K[1] *= height / self.height
        return replace(self, K=K, width=width, height=height)

    def at_most(self, side: int) -> Camera:
        """Return the camera with its image halved until both sides have at most `side` pixels."""
        halvings = 0
        while max(self.width, self.height) >> halvings > side:
            halvings += 1
        return self.resized(max(self.width >> halvings, 1), max(self.height >> halvings, 1)) if halvings else self


def _short(array: np.ndarray) -> list[float]:
    return [float(str(value)) for value in array.ravel()]


def facing(
    name: str,
    center: np.ndarray,
    forward: np.ndarray,
    focal: float,
    width: int,
    height: int,
    up: tuple[float, float, float] | np.ndarray = (0.0, 1.0, 0.0),
) -> Camera:
    """Return an upright camera.

    Args:
        name: Name of the camera.
        center: Optical center, [3], world units.
        forward: Unit viewing direction, [3].
        focal: Focal length in pixels.
        width: Image width in pixels.
        height: Image height in pixels.
        up: Up direction of the world, [3].
    """
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    viewmat[:3, 3] = -viewmat[:3, :3] @ center
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(name, viewmat, K, width, height)


def focus_point(cameras: list[Camera]) -> np.ndarray:
    """Return the least-squares closest point to all optical axes, [3] float64.

    A weak pull towards the mean camera center keeps nearly parallel rigs finite.
    """
    centers = np.stack([c.center for c in cameras]).astype(np.float64)
    directions = np.stack([c.forward for c in cameras]).astype(np.float64)
    projectors = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    ridge = 1e-4 * len(cameras)
    A = projectors.sum(0) + ridge * np.eye(3)
    b = np.einsum("nij,nj->i", projectors, centers) + ridge * centers.mean(0)
    return np.linalg.solve(A, b)


def angles_apart(cameras: list[Camera], focus: np.ndarray) -> np.ndarray:
    """Return the angles in degrees between cameras as seen from `focus` [3], [C, C]; the diagonal is infinite."""
    away = np.stack([camera.center for camera in cameras]).astype(np.float64) - focus
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    angles = np.degrees(np.arccos(np.clip(away @ away.T, -1, 1)))
    np.fill_diagonal(angles, np.inf)
    return angles


def middle_camera(cameras: list[Camera], focus: np.ndarray | None = None) -> int:
    """Return the index of the camera with the smallest sum of angles to all others, as seen from `focus`.

    Args:
        cameras: All cameras.
        focus: Point the cameras look at, [3]; None uses `focus_point`. On a ring the first camera is chosen.
    """
    angles = angles_apart(cameras, focus_point(cameras) if focus is None else focus)
    np.fill_diagonal(angles, 0)
    return int(angles.sum(1).round(3).argmin())


def unproject(camera: Camera, depth: np.ndarray) -> np.ndarray:
    """Return the world points [H, W, 3] float64 of a depth map [H, W]."""
    height, width = depth.shape
    x = (np.arange(width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    y = (np.arange(height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    local = np.stack([np.broadcast_to(x, depth.shape) * depth, y[:, None] * depth, depth], -1)
    return (local - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3].astype(np.float64)


def project(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels [..., 2] and depths [...] of world points [..., 3]. Pixels are NaN behind the camera."""
    local = points @ camera.viewmat[:3, :3].T.astype(np.float64) + camera.viewmat[:3, 3]
    depth = local[..., 2]
    safe = np.where(depth > 1e-9, depth, np.nan)
    x = local[..., 0] / safe * camera.K[0, 0] + camera.K[0, 2]
    y = local[..., 1] / safe * camera.K[1, 1] + camera.K[1, 2]
    return np.stack([x, y], -1), depth


def inside(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return which pixels [..., 2] lie in the camera's image; NaN does not."""
    x, y = pixels[..., 0], pixels[..., 1]
    return (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
