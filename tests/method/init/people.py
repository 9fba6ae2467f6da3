"""A made-up person: landmarks, the body around them, and the masks of cameras around it."""

import numpy as np

from splatreel.method.init.skeleton import Capsules, Seen, Skeleton, _bones
from splatreel.scene.camera import Camera, facing, project

HEIGHT = 1.7
PLACES = {
    0: (0.0, 1.58, 0.1),
    **dict(zip(range(1, 7), [(0.03 * s * k, 1.62, 0.09) for s in (1, -1) for k in (1, 2, 3)], strict=True)),
    7: (0.08, 1.6, 0.0),
    9: (0.02, 1.53, 0.09),
    11: (0.19, 1.4, 0.0),
    13: (0.42, 1.22, 0.05),
    15: (0.55, 1.0, 0.2),
    17: (0.57, 0.94, 0.26),
    19: (0.56, 0.93, 0.28),
    21: (0.53, 0.95, 0.25),
    23: (0.1, 0.9, 0.0),
    25: (0.16, 0.48, 0.06),
    27: (0.2, 0.08, 0.0),
    29: (0.2, 0.04, -0.05),
    31: (0.22, 0.03, 0.14),
}
"""Landmarks of the nose, the eyes and the left side, meters. y is up, and the person looks along z."""


def landmarks() -> np.ndarray:
    """Return the landmarks [33, 3] of a person who stands on the origin."""
    points = np.zeros((33, 3))
    for k, place in PLACES.items():
        points[k] = place
        if k >= 7:
            points[k + 1] = place * np.array([-1, 1, 1])
    return points


def body(points: np.ndarray) -> Capsules:
    """Return the body of a person."""
    bones = _bones(points)
    starts, ends, radii = (np.array(column) for column in zip(*bones, strict=True))
    return Capsules(starts, ends, HEIGHT * radii)


def around(count: int, width: int = 160, height: int = 120) -> list[Camera]:
    """Return cameras around the origin that look at the middle of a person."""
    views = []
    for k in range(count):
        angle = 2 * np.pi * (k + 0.3) / count
        center = np.array([3.5 * np.sin(angle), 1.5, 3.5 * np.cos(angle)])
        forward = np.array([0, 0.85, 0]) - center
        views.append(facing(f"c{k}", center, forward / np.linalg.norm(forward), 1.0 * width, width, height))
    return views


def seen_by(cameras: list[Camera], points: np.ndarray) -> list[Seen]:
    """Return what perfect networks see of a person in all cameras."""
    return [Seen(c, project(camera, points)[0], np.ones(33), 90.0) for c, camera in enumerate(cameras)]


def silhouettes(
    cameras: list[Camera], contains, low=(-0.8, -0.05, -0.7), high=(0.95, 1.75, 0.7), step: float = 0.018
) -> np.ndarray:
    """Return the masks [C, H, W] bool of what a function of points [N, 3] contains."""
    axes = [np.arange(a, b, step) for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    places = places[contains(places)]
    masks = np.zeros((len(cameras), cameras[0].height, cameras[0].width), bool)
    for mask, camera in zip(masks, cameras, strict=True):
        column, row = np.floor(project(camera, places)[0]).astype(int).T
        mask[row, column] = True
    return masks


def standing() -> Skeleton:
    """Return the skeleton of the person."""
    return Skeleton(landmarks(), HEIGHT)
