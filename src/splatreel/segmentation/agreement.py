"""Agreement of the views: the places that several cameras show as subject, and what they say about each image."""

from __future__ import annotations

import cv2
import numpy as np

from splatreel.scene.camera import Camera, focus_point
from splatreel.segmentation.evidence import LIMIT

CELLS = 64
"""Number of coarse cells along each side of the searched cube."""
FINE = 3
"""Number of fine cells along a side of a coarse cell."""
AGAINST = 2.0
"""Weight of a view that shows background at a place, relative to a view that shows the subject there."""
MIN_OTHERS = 2
"""Number of other cameras that must see a place before their evidence counts."""


class Agreement:
    """Cube around the place that the cameras look at, from which the subject is carved.

    Args:
        cameras: C cameras, at the size of the evidence.
        near: Smallest depth, world units.
    """

    def __init__(self, cameras: list[Camera], near: float = 0.0) -> None:
        self.cameras = cameras
        self.near = max(near, 1e-6)
        low, self.size = _cube(cameras)
        steps = (np.arange(CELLS, dtype=np.float32) + 0.5) * self.size
        places = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3) + low
        views = np.sum([self._project(places, camera)[0] >= 0 for camera in cameras], 0)
        self._coarse = places[views > min(MIN_OTHERS, len(cameras) - 1)]
        self._projected = [self._project(self._coarse, camera) for camera in cameras]
        offsets = np.stack(np.meshgrid(*[np.arange(FINE)] * 3, indexing="ij"), -1).reshape(-1, 3)
        self._offsets = (((offsets + 0.5) / FINE - 0.5) * self.size).astype(np.float32)

    def support(self, evidence: np.ndarray) -> np.ndarray:
        """Return what the other cameras say about each pixel, [C, H, W] float32, in the unit of the evidence.

        The value of a pixel is the largest mean of the other cameras' evidence over the places on its ray. It is very negative
        where no place is supported.

        Args:
            evidence: [C, H, W] float32, log odds.
        """
        places = (self._occupied(evidence)[:, None] + self._offsets).reshape(-1, 3)
        projected = [self._project(places, camera) for camera in self.cameras]
        values = np.stack([_look_up(view, pixels) for (pixels, _), view in zip(projected, evidence, strict=True)])
        seen, total = np.sum([pixels >= 0 for pixels, _ in projected], 0), values.sum(0)
        out = np.full(evidence.shape, -AGAINST * LIMIT, np.float32)
        for c, (pixels, depth) in enumerate(projected):
            others = seen - 1  # for the places that this camera sees
            use = (pixels >= 0) & (others >= min(MIN_OTHERS, len(self.cameras) - 1))
            mean = (total - values[c])[use] / others[use]
            self._splat(out[c], pixels[use], depth[use], mean, self.cameras[c])
        return out

    def _project(self, places: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Return the index of each place's pixel, -1 outside of the image, and the depth of each place."""
        viewmat, K = camera.viewmat.astype(np.float32), camera.K.astype(np.float32)
        seen = places @ viewmat[:3, :3].T + viewmat[:3, 3]
        depth = seen[:, 2]
        ahead = depth > self.near
        pixels = (seen @ K.T)[:, :2] / np.where(ahead, depth, 1)[:, None]
        inside = ahead & ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(1)
        column, row = np.where(inside[:, None], pixels, 0).astype(np.int32).T
        return np.where(inside, row * camera.width + column, -1), depth

    def _occupied(self, evidence: np.ndarray) -> np.ndarray:
        """Return the centers of coarse cells that may hold the subject, [N, 3]."""
        total = np.zeros(len(self._coarse), np.float32)
        for camera, (pixels, depth), view in zip(self.cameras, self._projected, evidence, strict=True):
            if (pixels >= 0).any():
                reach = 0.75 * self.size * camera.K[0, 0] / float(np.median(depth[pixels >= 0]))
                total += _look_up(cv2.dilate(view, _square(reach)), pixels)
        return self._coarse[total > 0]

    def _splat(
        self, out: np.ndarray, pixels: np.ndarray, depth: np.ndarray, values: np.ndarray, camera: Camera
    ) -> None:
        """Write the largest of the values into each pixel of an image. A cell covers as many pixels as it appears wide."""
        if len(pixels) == 0:
            return
        order = np.argsort(values, kind="stable")
        flat = out.ravel()
        flat[pixels[order]] = values[order]  # of equal indices, the last and largest remains
        reach = 0.5 * self.size / FINE * camera.K[0, 0] / float(np.percentile(depth, 10))
        out[:] = cv2.dilate(flat.reshape(out.shape), _square(reach))


def _square(reach: float) -> np.ndarray:
    """Return a kernel that reaches at least `reach` pixels."""
    return np.ones((2 * int(np.ceil(reach)) + 1,) * 2, np.uint8)


def _look_up(view: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the evidence at pixels, 0 outside of the image. Evidence of the background weighs more."""
    value = np.where(pixels >= 0, view.ravel()[np.maximum(pixels, 0)], 0)
    return np.where(value < 0, AGAINST * value, value)


def _cube(cameras: list[Camera]) -> tuple[np.ndarray, float]:
    """Return the lower corner of the cube, [3] float32, and the size of a coarse cell."""
    middle = focus_point(cameras)
    distances = np.linalg.norm(np.stack([camera.center for camera in cameras]) - middle, axis=1)
    reach = float(np.percentile(distances, 90))
    return (middle - reach).astype(np.float32), 2 * reach / CELLS
