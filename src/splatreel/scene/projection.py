"""Projection of world points to the pixels of a camera, and back."""

from __future__ import annotations

import numpy as np

from splatreel.scene.camera import Camera


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
