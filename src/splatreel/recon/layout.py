"""How a capture lies in space: measures that every learning rate and threshold is relative to."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from splatreel.scene.camera import Camera


@dataclass(frozen=True)
class Layout:
    """near: near plane; unit: typical viewing distance (both world units); up: unit vector; bounds: low and high corner."""

    near: float
    unit: float
    up: list[float]
    bounds: list[list[float]]

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def measure(cameras: list[Camera], points: np.ndarray, near: float) -> Layout:
    """Lay out a capture from its training cameras and initial points [P, 3]."""
    up = -np.mean([camera.viewmat[1, :3] for camera in cameras], axis=0)
    length = np.linalg.norm(up)
    up = up / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
    low, high = np.percentile(points, [5, 95], axis=0)
    return Layout(
        near=float(near),
        unit=viewing_distance(cameras, points),
        up=[float(v) for v in up],
        bounds=[[float(v) for v in low], [float(v) for v in high]],
    )


def viewing_distance(cameras: list[Camera], points: np.ndarray) -> float:
    """Median over the cameras of the median depth of the points each one sees."""
    medians = []
    for camera in cameras:
        local = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        pixels = local @ camera.K.T
        z = np.maximum(pixels[:, 2], 1e-9)
        u, v = pixels[:, 0] / z, pixels[:, 1] / z
        seen = (pixels[:, 2] > 1e-6) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        if seen.any():
            medians.append(float(np.median(local[seen, 2])))
    return float(np.median(medians)) if medians else 1.0
