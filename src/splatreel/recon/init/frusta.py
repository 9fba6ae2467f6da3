"""Depth ranges in which views overlap, and the number of planes for them. Long lenses see a thin slice of depths in many pixels."""

from __future__ import annotations

import math

import numpy as np

from splatreel.recon.init.planesweep import NEIGHBORS, inside, plane_homographies, project, unproject
from splatreel.recon.init.triangulate import nearest_cameras
from splatreel.scene.camera import Camera

MAX_SPACING, WANTED_SPACING = 5.0, 1.5
"""Spacing of planes, pixels: the range is refined above `MAX_SPACING`, to a spacing of `WANTED_SPACING`."""
MOST_PLANES = 320
SAMPLE_GRID, DEPTH_LEVELS = (9, 7), 256
"""Samples: pixels across and down an image, and inverse depths."""
MIN_PIXEL_SHARE, MIN_PARTNERS = 0.05, 2
"""A depth counts if at least `MIN_PIXEL_SHARE` of these pixels are seen by `MIN_PARTNERS` neighbors there."""


def narrow_ranges(cameras: list[Camera], ranges: np.ndarray, width: int, planes: int) -> tuple[np.ndarray, np.ndarray]:
    """Narrow the depth ranges of cameras whose planes would be too far apart, and choose the number of planes.

    A range is narrowed to the depths that neighbors see too. Other cameras keep their range and `planes` planes.

    Args:
        cameras: All cameras.
        ranges: [C, 2] nearest and farthest depth, world units.
        width: Width of the depth maps, pixels.
        planes: Number of planes.

    Returns:
        Ranges [C, 2], and the number of planes [C].
    """
    nearest = nearest_cameras(cameras, NEIGHBORS)
    height = max(round(cameras[0].height * width / cameras[0].width), 1)
    small = [camera.resized(width, height) for camera in cameras]
    ranges, counts = ranges.copy(), np.full(len(cameras), planes)
    for i, camera in enumerate(small):
        others = [small[j] for j in nearest[i]]
        if pixels_apart(camera, others, ranges[i], planes) > MAX_SPACING:
            ranges[i] = shared_depths(camera, others, ranges[i])
            wanted = (planes - 1) * pixels_apart(camera, others, ranges[i], planes) / WANTED_SPACING
            counts[i] = min(max(math.ceil(wanted) + 1, planes), MOST_PLANES)
    return ranges, counts


def pixels_apart(camera: Camera, others: list[Camera], depths: np.ndarray, planes: int) -> float:
    """Return the spacing of planes, pixels: median over the planes, mean over the other cameras, at the image center.

    Args:
        camera: Camera of the depth map.
        others: Cameras that are compared with it.
        depths: [2] nearest and farthest depth, world units.
        planes: Number of planes.
    """
    levels = np.linspace(1 / depths[1], 1 / depths[0], planes)
    middle = np.array([camera.width / 2 - 0.5, camera.height / 2 - 0.5, 1])
    found = []
    for other in others:
        shown = plane_homographies(camera, other, 1 / levels) @ middle
        before = shown[:, 2] > 1e-6
        pixels = shown[before, :2] / shown[before, 2:]
        if len(pixels) > 1:
            found.append(float(np.median(np.linalg.norm(np.diff(pixels, axis=0), axis=1))))
    return float(np.mean(found)) if found else 0.0


def shared_depths(camera: Camera, others: list[Camera], depths: np.ndarray) -> np.ndarray:
    """Return the part [2] of a depth range in which other cameras see a part of the image; the whole range if there is none."""
    levels = np.linspace(1 / depths[0], 1 / depths[1], DEPTH_LEVELS)
    rays = unproject(camera.resized(*SAMPLE_GRID), np.ones(SAMPLE_GRID[::-1])).reshape(-1, 3) - camera.center
    places = camera.center + rays / levels[:, None, None]
    seen = np.sum([inside(other, project(other, places)[0]) for other in others], axis=0)
    shared = (seen >= min(MIN_PARTNERS, len(others))).mean(1) >= MIN_PIXEL_SHARE
    if not shared.any():
        return depths
    first, last = np.flatnonzero(shared)[[0, -1]]
    return np.array([1 / levels[max(first - 1, 0)], 1 / levels[min(last + 1, DEPTH_LEVELS - 1)]])
