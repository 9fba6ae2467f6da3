"""Small captures that are rendered on demand: a wall of blots, and a cluster of them that may pass in front of it."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.capture.base import Capture
from splatreel.kernels.image import render_image
from splatreel.scene.gaussians import Gaussians
from tests.method.scenes import ring

WIDTH, HEIGHT = 48, 32


def blots(count: int, low: list[float], high: list[float], size: float, seed: int) -> Gaussians:
    rng = np.random.default_rng(seed)
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    sh = rng.uniform(-1.7, 1.7, (count, 1, 3))
    return Gaussians(rng.uniform(low, high, (count, 3)), quats, np.full((count, 3), size), np.full(count, 0.95), sh)


@cache
def make_image(camera: int, cameras: int, offset: float, dims: bool, smooth: bool = False) -> np.ndarray:
    wall = blots(40 if smooth else 500, [-3, -2, 0.9], [3, 2, 1.0], 0.5 if smooth else 0.12, 0)
    thing = blots(12 if smooth else 60, [-1.6, -0.6, -0.4], [-0.6, 0.6, 0.2], 0.3 if smooth else 0.09, 1)
    thing.means[:, 0] += offset
    image = render_image(Gaussians.concatenate([wall, thing]), ring(cameras, width=WIDTH, height=HEIGHT)[camera])
    return (np.clip(image * (0.5 if dims else 1.0), 0, 1) * 255).round().astype(np.uint8)


class WallCapture(Capture):
    """speed: world units a frame of the cluster; dims: each second frame is half as bright, so that everything changes.

    drift: logarithm by which each camera's exposure goes up and down, by itself. smooth: few large blots, easy to reconstruct.
    """

    def __init__(
        self,
        frames: int,
        *,
        cameras: int = 4,
        speed: float = 0.3,
        dims: bool = False,
        drift: float = 0.0,
        smooth: bool = False,
        **options: Any,
    ) -> None:
        self.speed, self.dims, self.drift, self.smooth = speed, dims, drift, smooth
        views = ring(cameras, width=WIDTH, height=HEIGHT)
        super().__init__(Path("wall"), views, held_out=[], frame_range=(0, frames), **options)

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        for c, name in enumerate(cameras):
            number = [camera.name for camera in self.cameras].index(name)
            for t in range(len(out)):
                dims = self.dims and (first + t) % 2 == 1
                shown = make_image(number, len(self.cameras), self.speed * (first + t), dims, self.smooth)
                out[t, c] = np.rint(shown * self.exposure(number, first + t)).clip(0, 255)

    def exposure(self, camera: int, frame: int) -> float:
        """The factor of a camera's images, 1 in the first frame."""
        return float(np.exp(self.drift * (np.sin(1.7 * camera + frame) - np.sin(1.7 * camera))))
