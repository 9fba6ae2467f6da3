"""Where cameras' views meet, and how many planes a sweep takes there: long lenses see a thin slice of depths, in many pixels."""

from __future__ import annotations

import math

import numpy as np

from splatreel.recon.init.planesweep import NEIGHBORS, inside, plane_homographies, project, unproject
from splatreel.recon.init.triangulate import nearest_cameras
from splatreel.scene.camera import Camera

COARSE, FINE = 5.0, 1.5
"""Pixels of a depth map from plane to plane that are too many, and that are wanted then."""
MOST_PLANES = 320
GRID, LEVELS = (9, 7), 256
"""Pixels across and down a picture, and inverse depths, that are looked at."""
SHARE, PARTNERS = 0.05, 2
"""Of these pixels, those that so many neighbors must see at a depth for it to count."""


def focused(cameras: list[Camera], ranges: np.ndarray, width: int, planes: int) -> tuple[np.ndarray, np.ndarray]:
    """Ranges [C, 2] of depth, world units, and [C] how many planes to sweep there.

    ranges: [C, 2] where depths may be. width: of the maps, pixels. Where `planes` planes are so far apart that the pictures hardly fit
    on any, the range is cut to what neighbors see as well, and has more of them; else nothing changes.
    """
    nearest = nearest_cameras(cameras, NEIGHBORS)
    height = max(round(cameras[0].height * width / cameras[0].width), 1)
    small = [camera.resized(width, height) for camera in cameras]
    ranges, counts = ranges.copy(), np.full(len(cameras), planes)
    for i, camera in enumerate(small):
        others = [small[j] for j in nearest[i]]
        if pixels_apart(camera, others, ranges[i], planes) > COARSE:
            ranges[i] = shared_depths(camera, others, ranges[i])
            wanted = (planes - 1) * pixels_apart(camera, others, ranges[i], planes) / FINE
            counts[i] = min(max(math.ceil(wanted) + 1, planes), MOST_PLANES)
    return ranges, counts


def pixels_apart(camera: Camera, others: list[Camera], depths: np.ndarray, planes: int) -> float:
    """How far from plane to plane the middle of a camera's picture moves in the others', median of the planes, mean of the cameras.

    depths: [2], nearest and farthest.
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
    """[2] the part of a range of depths in which other cameras see some of what a camera does; all of it where they nowhere do."""
    levels = np.linspace(1 / depths[0], 1 / depths[1], LEVELS)
    rays = unproject(camera.resized(*GRID), np.ones(GRID[::-1])).reshape(-1, 3) - camera.center
    places = camera.center + rays / levels[:, None, None]
    seen = np.sum([inside(other, project(other, places)[0]) for other in others], axis=0)
    shared = (seen >= min(PARTNERS, len(others))).mean(1) >= SHARE
    if not shared.any():
        return depths
    first, last = np.flatnonzero(shared)[[0, -1]]
    return np.array([1 / levels[max(first - 1, 0)], 1 / levels[min(last + 1, LEVELS - 1)]])
