"""Dense depth by plane sweep and semi-global matching, for surfaces without features.

For every camera, planes parallel to its image are swept through the scene. The image of each neighbor is warped by the
homography of the plane and compared patch by patch. Zero-mean normalized cross-correlation ignores the cameras' different
gains. Paths in four directions carry depth into weak texture.

Source:
    Hirschmueller 2008, "Stereo processing by semiglobal matching".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numba
import numpy as np

from splatreel.base import threads
from splatreel.method.init.triangulate import nearest_cameras
from splatreel.scene.camera import Camera, inside, project, unproject

NEIGHBORS = 4
PATCH = 5
NOISE = 2.5 / 255
"""Standard deviation below which a patch counts as flat. Noise would otherwise correlate by chance."""
SMALL_STEP, LARGE_STEP = 0.06, 0.5
"""Costs of a change of depth by one plane, and by more, between neighboring pixels (P1 and P2 of semi-global matching)."""
AGREEMENT_PLANES = 1.5
MAX_SPACING, WANTED_SPACING = 5.0, 1.5
"""Spacing of planes, pixels: the range is refined above `MAX_SPACING`, to a spacing of `WANTED_SPACING`."""
MOST_PLANES = 320
MOST_VOLUMES = 8
"""Maximum number of cost volumes in memory, up to 200 MB each."""
SAMPLE_GRID, DEPTH_LEVELS = (9, 7), 256
"""Samples: pixels across and down an image, and inverse depths."""
MIN_PIXEL_SHARE, MIN_PARTNERS = 0.05, 2
"""A depth counts if at least `MIN_PIXEL_SHARE` of these pixels are seen by `MIN_PARTNERS` neighbors there."""


@dataclass(frozen=True)
class DepthMap:
    """Depth map [H, W] of a camera, world units along its axis, and the number of neighbors whose maps agree at each pixel."""

    camera: Camera
    image: np.ndarray
    depth: np.ndarray
    agreeing: np.ndarray


def sweep(
    cameras: list[Camera], images: np.ndarray, ranges: np.ndarray, *, width: int = 320, planes: int | np.ndarray = 96
) -> list[DepthMap]:
    """Compute one depth map per camera, `width` pixels wide, from images [C, H, W, 3] uint8.

    `ranges` [C, 2] are the nearest and farthest depths. `planes` is their number, for all cameras or for each.
    """
    width = min(width, images.shape[2])
    height = max(round(images.shape[1] * width / images.shape[2]), 1)
    small_cameras = [c.resized(width, height) for c in cameras]
    small = [cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) for image in images]
    grays = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255 for image in small]
    nearest = nearest_cameras(cameras, NEIGHBORS)
    counts = np.broadcast_to(planes, len(cameras))
    steps = (1 / ranges[:, 0] - 1 / ranges[:, 1]) / (counts - 1)

    def depth_of(i: int) -> np.ndarray:
        levels = 1 / ranges[i, 1] + steps[i] * np.arange(counts[i])
        others = [(small_cameras[j], grays[j]) for j in nearest[i]]
        cost = _cost_volume(small_cameras[i], grays[i], others, 1 / levels)
        best = _best_levels(_aggregate(cost, grays[i]))
        return (1 / (levels[0] + steps[i] * best)).astype(np.float32)

    with threads.at_most(MOST_VOLUMES):
        depths = threads.map_parallel(depth_of, range(len(cameras)))

    def compared(i: int) -> DepthMap:
        found = [_agreement(small_cameras[i], depths[i], steps[i], small_cameras[j], depths[j]) for j in nearest[i]]
        return DepthMap(small_cameras[i], small[i], depths[i], np.asarray(sum(found), np.uint8))

    return threads.map_parallel(compared, range(len(cameras)))


def seen_depths(cameras: list[Camera], points: np.ndarray) -> list[np.ndarray]:
    """Return the depths of the points inside each camera's image."""
    found = []
    for camera in cameras:
        pixels, depth = project(camera, points)
        found.append(depth[inside(camera, pixels)])
    return found


def _cost_volume(
    camera: Camera, gray: np.ndarray, others: list[tuple[Camera, np.ndarray]], depths: np.ndarray
) -> np.ndarray:
    """Return matching costs [H, W, D] float32, 0 (alike) to 1."""
    size = (camera.width, camera.height)
    mean, square = cv2.blur(gray, (PATCH, PATCH)), cv2.blur(gray * gray, (PATCH, PATCH))
    deviation = np.sqrt(np.maximum(square - mean * mean, 0) + NOISE**2)
    volume = np.empty((len(depths), *gray.shape), np.float32)
    scores = np.empty((len(others), 4, *gray.shape), np.float32)
    homographies = [plane_homographies(camera, other, depths) for other, _ in others]
    corners = np.array([[0, 0, 1], [size[0], 0, 1], [0, size[1], 1], [size[0], size[1], 1]], np.float64)
    for d in range(len(depths)):
        for k, (_, image) in enumerate(others):
            H = homographies[k][d]
            if (corners @ H[2]).min() <= 1e-6:  # part of the plane is behind the other camera
                scores[k, 0] = -1
                continue
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            warped = cv2.warpPerspective(image, H, size, flags=flags, borderValue=(-1e4,))
            scores[k, 0] = cv2.blur(warped, (PATCH, PATCH))
            scores[k, 1] = cv2.blur(warped * warped, (PATCH, PATCH))
            scores[k, 2] = cv2.blur(warped * gray, (PATCH, PATCH))
        _correlate(mean, deviation, scores, volume[d])
    return np.ascontiguousarray(volume.transpose(1, 2, 0))


def plane_homographies(camera: Camera, other: Camera, depths: np.ndarray) -> np.ndarray:
    """Return the homographies [D, 3, 3] between two cameras via the planes z = depth. Pixel centers are integers, as in OpenCV."""
    relative = other.viewmat.astype(np.float64) @ np.linalg.inv(camera.viewmat.astype(np.float64))
    shift = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
    tilt = np.zeros((len(depths), 3, 3))
    tilt[:, :, 2] = relative[:3, 3] / depths[:, None]
    return (shift @ other.K) @ (relative[:3, :3] + tilt) @ np.linalg.inv(shift @ camera.K.astype(np.float64))


@numba.njit(nogil=True, cache=True, fastmath=True)
def _correlate(mean, deviation, scores, plane):  # pragma: no cover - compiled
    """Write one plane of costs: the mean of the better half of the neighbors, so that occluded ones do not count."""
    count = scores.shape[0]
    half = (count + 1) // 2
    for y in range(mean.shape[0]):
        found = np.empty(count, np.float32)
        for x in range(mean.shape[1]):
            valid = 0
            for k in range(count):
                other = scores[k, 0, y, x]
                if other < 0:  # outside of the neighbor's image
                    continue
                variance = max(scores[k, 1, y, x] - other * other, 0.0) + np.float32(NOISE * NOISE)
                value = (scores[k, 2, y, x] - mean[y, x] * other) / (deviation[y, x] * np.sqrt(variance))
                place = valid
                while place > 0 and found[place - 1] < value:
                    found[place] = found[place - 1]
                    place -= 1
                found[place] = value
                valid += 1
            used = min(half, valid)
            total = np.float32(0)
            for k in range(used):
                total += found[k]
            score = total / used if used > 0 else np.float32(0)
            plane[y, x] = min(max(np.float32(1) - score, np.float32(0)), np.float32(1))


def _aggregate(cost: np.ndarray, gray: np.ndarray) -> np.ndarray:
    """Return the sum [H, W, D] of the path costs from left, right, top and bottom."""
    total = np.zeros_like(cost)
    _scan_rows(cost, gray, total)
    _scan_rows(cost.transpose(1, 0, 2), gray.T, total.transpose(1, 0, 2))
    return total


@numba.njit(nogil=True, cache=True, fastmath=True)
def _scan_rows(cost, gray, total):  # pragma: no cover - compiled
    """Add the path costs of both directions along every row. A jump in depth costs less at an image edge."""
    height, width, planes = cost.shape
    for y in range(height):
        previous = np.empty(planes, np.float32)
        current = np.empty(planes, np.float32)
        for direction in range(2):
            lowest = np.float32(0)
            for i in range(width):
                x = i if direction == 0 else width - 1 - i
                if i == 0:
                    for d in range(planes):
                        previous[d] = cost[y, x, d]
                        total[y, x, d] += previous[d]
                else:
                    edge = abs(gray[y, x] - gray[y, x - 1 if direction == 0 else x + 1])
                    jump = lowest + max(np.float32(LARGE_STEP) / (1 + 30 * edge), np.float32(2 * SMALL_STEP))
                    for d in range(planes):
                        best = min(previous[d], jump)
                        if d > 0:
                            best = min(best, previous[d - 1] + np.float32(SMALL_STEP))
                        if d < planes - 1:
                            best = min(best, previous[d + 1] + np.float32(SMALL_STEP))
                        current[d] = cost[y, x, d] + best - lowest
                        total[y, x, d] += current[d]
                    previous, current = current, previous
                lowest = previous.min()


@numba.njit(nogil=True, cache=True)
def _best_levels(total):  # pragma: no cover - compiled
    """Return the plane of least cost, [H, W] float32, refined by a parabola."""
    height, width, planes = total.shape
    best = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            d = np.argmin(total[y, x])
            fraction = np.float32(0)
            if 0 < d < planes - 1:
                low, mid, high = total[y, x, d - 1], total[y, x, d], total[y, x, d + 1]
                bend = low - 2 * mid + high
                if bend > 1e-6:
                    fraction = np.float32(0.5) * (low - high) / bend
            best[y, x] = d + fraction
    return best


def _agreement(camera: Camera, depth: np.ndarray, step: float, other: Camera, other_depth: np.ndarray) -> np.ndarray:
    """Return [H, W] bool, the pixels for which the other camera's map has a surface within a few planes."""
    pixels, seen_depth = project(other, unproject(camera, depth))
    visible = inside(other, pixels)
    column, row = np.where(visible[..., None], pixels, 0).astype(int).transpose(2, 0, 1)
    found = np.zeros((*depth.shape, 3))
    found[visible] = unproject(other, other_depth)[row[visible], column[visible]]
    own_depth = project(camera, found)[1]
    error = np.abs(1 / np.maximum(own_depth, 1e-9) - 1 / depth)
    return visible & (seen_depth > 0) & (error < AGREEMENT_PLANES * step)


def narrow_ranges(cameras: list[Camera], ranges: np.ndarray, width: int, planes: int) -> tuple[np.ndarray, np.ndarray]:
    """Narrow the depth ranges [C, 2] of cameras whose planes would be too far apart, and choose the number of planes [C].

    A range is narrowed to the depths that neighbors see too. Other cameras keep their range and `planes` planes. Maps
    are `width` pixels wide.
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
    """Return the spacing of planes, pixels: median over the planes, mean over the other cameras, at the image center."""
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
