"""Volumes that contain points or not: box, sphere, upright cylinder, and the volume that many cameras see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from splatreel.scene.camera import Camera


class Volume(Protocol):
    """Part of space."""

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        ...

    def bounds(self) -> np.ndarray | None:
        """Return the box around the volume, [2, 3]; None if it has no simple one."""
        ...


@dataclass(frozen=True)
class Box:
    """Box with axes of the world, from its low to its high corner, [3] each."""

    low: np.ndarray
    high: np.ndarray

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        return np.all((points >= self.low) & (points <= self.high), axis=-1)

    def bounds(self) -> np.ndarray:
        """Return the corners, [2, 3]."""
        return np.stack([self.low, self.high])


@dataclass(frozen=True)
class Sphere:
    """Sphere around a center, [3]."""

    center: np.ndarray
    radius: float

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        return np.square(points - self.center).sum(-1) <= self.radius**2

    def bounds(self) -> np.ndarray:
        """Return the box around the sphere, [2, 3]."""
        return np.stack([self.center - self.radius, self.center + self.radius])


@dataclass(frozen=True)
class Cylinder:
    """Cylinder that stands on the middle of its base, [3], along a unit direction `up` [3]."""

    base: np.ndarray
    up: np.ndarray
    radius: float
    height: float

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        away = points - self.base
        along = away @ self.up
        beside = np.square(away).sum(-1) - along**2
        return (along >= 0) & (along <= self.height) & (beside <= self.radius**2)

    def bounds(self) -> np.ndarray:
        """Return the box around the cylinder, [2, 3]."""
        across = self.radius * np.sqrt(np.maximum(1 - self.up**2, 0))
        ends = np.stack([self.base, self.base + self.height * self.up])
        return np.stack([ends.min(0) - across, ends.max(0) + across])


@dataclass(frozen=True)
class CaptureVolume:
    """Space in the images of at least a share of the cameras, beyond the depth `near` of each."""

    cameras: Sequence[Camera]
    near: float
    share: float = 0.5

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        seen = np.zeros(points.shape[:-1], np.int64)
        for camera in self.cameras:
            seen += in_image(points, camera, self.near)[0]
        return seen >= max(self.share * len(self.cameras), 1)

    def bounds(self) -> None:
        """Return None: the volume may have no end."""
        return


@dataclass(frozen=True)
class Outside:
    """Everything outside of a volume."""

    volume: Volume

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are outside of the volume, [...] bool."""
        return ~self.volume.contains(points)

    def bounds(self) -> None:
        """Return None: the outside has no end."""
        return


def in_image(points: np.ndarray, camera: Camera, near: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points [..., 3] into a camera.

    Returns:
        Which points are in the image and deeper than `near`, [...] bool; their pixels, [..., 2]; their depths, [...].
    """
    seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    depth = seen[..., 2]
    ahead = depth > near
    pixels = seen @ camera.K.T
    pixels = pixels[..., :2] / np.where(ahead, depth, 1)[..., None]
    inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(-1)
    return ahead & inside, pixels, depth
