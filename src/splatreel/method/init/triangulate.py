"""Image features, and sparse points from their matches between cameras with known poses.

Only features near each other's epipolar line are compared. Repeated texture then does less harm than in matching without poses,
and more weak features survive. Two-view matches are often false, so a point must be seen by three cameras.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.scene.camera import Camera

MAX_FEATURES = 3000
MIN_SIMILARITY = 0.7
RATIO = 0.85


@dataclass(frozen=True)
class Features:
    """SIFT features of an image.

    Attributes:
        pixels: [F, 2] float64, pixel centers at +0.5.
        descriptors: [F, 128] float32, unit length (RootSIFT).
        colors: [F, 3] uint8.
    """

    pixels: np.ndarray
    descriptors: np.ndarray
    colors: np.ndarray

    def __getitem__(self, which: np.ndarray) -> Features:
        """Select features by index or mask."""
        return Features(self.pixels[which], self.descriptors[which], self.colors[which])


def detect(image: np.ndarray) -> Features:
    """Detect SIFT features in an image [H, W, 3] uint8."""
    sift = cv2.SIFT.create(MAX_FEATURES, contrastThreshold=0.01, edgeThreshold=20)
    keypoints, descriptors = sift.detectAndCompute(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), None)
    if descriptors is None or len(keypoints) == 0:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), np.zeros((0, 3), np.uint8))
    pixels = np.array([k.pt for k in keypoints], np.float64)
    column, row = np.rint(pixels).astype(int).T
    height, width = image.shape[:2]
    colors = image[row.clip(0, height - 1), column.clip(0, width - 1)]
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9))
    return Features(pixels + 0.5, root.astype(np.float32), colors)


def fundamental(a: Camera, b: Camera) -> np.ndarray:
    """Return the fundamental matrix F with x_b^T F x_a = 0 for homogeneous pixels."""
    relative = b.viewmat.astype(np.float64) @ np.linalg.inv(a.viewmat.astype(np.float64))
    x, y, z = relative[:3, 3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.linalg.inv(b.K.astype(np.float64)).T @ cross @ relative[:3, :3] @ np.linalg.inv(a.K.astype(np.float64))


def epipolar_lines(camera_a: Camera, camera_b: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return the epipolar lines [F, 3] in view b of pixels [F, 2] in view a, with unit normals."""
    lines = np.c_[pixels, np.ones(len(pixels))] @ fundamental(camera_a, camera_b).T
    return lines / np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)


def line_distances(lines: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the signed distances [F] of pixels [F, 2] from lines [F, 3]."""
    return (lines[:, :2] * pixels).sum(1) + lines[:, 2]


def match(camera_a: Camera, camera_b: Camera, a: Features, b: Features, reach: float | np.ndarray) -> np.ndarray:
    """Return mutual best matches [M, 2] near the epipolar lines that pass the ratio test, as indices into a and b.

    `reach` is the maximum distance from the line, pixels, for all pairs or for each pair [A, B].
    """
    if len(a.pixels) == 0 or len(b.pixels) == 0:
        return np.zeros((0, 2), np.int64)
    lines = epipolar_lines(camera_a, camera_b, a.pixels)
    distance = lines.astype(np.float32) @ np.c_[b.pixels, np.ones(len(b.pixels))].T.astype(np.float32)
    similarity = a.descriptors @ b.descriptors.T
    similarity[np.abs(distance) > reach] = -1
    rows = np.arange(len(a.pixels))
    best = similarity.argmax(1)
    mutual = similarity.argmax(0)[best] == rows
    score = similarity[rows, best].copy()
    similarity[rows, best] = -1
    second = similarity.max(1)
    gap = np.sqrt(np.maximum(2 - 2 * score, 0)) < RATIO * np.sqrt(np.maximum(2 - 2 * second, 0))
    good = mutual & gap & (score > MIN_SIMILARITY)
    return np.stack([rows[good], best[good]], 1)


EPIPOLAR_PIXELS = 1.5
VOTE_PIXELS = 3.0
REPROJECTION_PIXELS = 1.5
MIN_ANGLE_DEGREES = 1.5
MIN_VIEWS = 3


@dataclass(frozen=True)
class Tracks:
    """Points seen by at least three cameras.

    Attributes:
        points: [P, 3] float64 world.
        colors: [P, 3] float32 0..1.
        seen: [P, C] bool, cameras that see each point.
    """

    points: np.ndarray
    colors: np.ndarray
    seen: np.ndarray


def triangulate(cameras: list[Camera], images: np.ndarray, neighbors: int = 8) -> Tracks:
    """Match SIFT features between neighboring cameras and triangulate the ones that at least three cameras agree on.

    Images without texture give no points; that is not an error.
    """
    features = threads.map_parallel(detect, images)
    first = np.cumsum([0] + [len(f.pixels) for f in features])
    edges: list[np.ndarray] = [np.zeros((0, 2), np.int64)]

    def edges_of(pair: tuple[int, int]) -> np.ndarray:
        i, j = pair
        matches = match(cameras[i], cameras[j], features[i], features[j], EPIPOLAR_PIXELS)
        return matches + np.array([first[i], first[j]])

    edges += threads.map_parallel(edges_of, neighbor_pairs(cameras, neighbors))
    pairs = np.concatenate(edges)
    camera = np.repeat(np.arange(len(cameras)), np.diff(first))
    pixels = np.concatenate([f.pixels for f in features])
    colors = np.concatenate([f.colors for f in features])
    return _solve_stars(cameras, np.concatenate([pairs, pairs[:, ::-1]]), camera, pixels, colors)


def neighbor_pairs(cameras: list[Camera], neighbors: int) -> list[tuple[int, int]]:
    """Return the pairs i < j of cameras of which one is among the nearest neighbors of the other."""
    nearest = nearest_cameras(cameras, neighbors)
    return sorted({(min(i, int(j)), max(i, int(j))) for i in range(len(cameras)) for j in nearest[i]})


def nearest_cameras(cameras: list[Camera], count: int) -> np.ndarray:
    """Return the nearest cameras to each camera, nearest first; [C, min(count, C - 1)] int."""
    return _nearest(separation(cameras), count)


def nearest_poses(centers: np.ndarray, forwards: np.ndarray, count: int) -> np.ndarray:
    """Return what `nearest_cameras` returns, for positions [C, 3] and viewing directions [C, 3]."""
    return _nearest(_separation(centers, forwards), count)


def separation(cameras: list[Camera]) -> np.ndarray:
    """Return how different the cameras' views are, [C, C]: distance relative to the median, plus 1 - cosine of the directions."""
    return _separation(np.stack([c.center for c in cameras]), np.stack([c.forward for c in cameras]))


def _nearest(cost: np.ndarray, count: int) -> np.ndarray:
    np.fill_diagonal(cost, np.inf)
    return np.argsort(cost, 1, kind="stable")[:, : min(count, len(cost) - 1)]


def _separation(centers: np.ndarray, forwards: np.ndarray) -> np.ndarray:
    centers, forwards = centers.astype(np.float64), forwards.astype(np.float64)
    gaps = np.linalg.norm(centers[:, None] - centers[None], axis=-1)
    spread = np.median(gaps) or 1.0
    return gaps / spread + (1 - forwards @ forwards.T)


def _solve_stars(
    cameras: list[Camera], edges: np.ndarray, camera: np.ndarray, pixels: np.ndarray, colors: np.ndarray
) -> Tracks:
    """Triangulate one point for every feature whose matches in at least two other cameras agree.

    A feature and its direct matches form a star. Longer chains (connected components) would merge most of an image into one
    track through a few false matches. Every edge of a star proposes a point; the point with the most votes of other edges wins.
    """
    edges = edges[np.argsort(edges[:, 0], kind="stable")]
    projections = np.stack([c.K.astype(np.float64) @ c.viewmat[:3].astype(np.float64) for c in cameras])
    owner = np.repeat(np.arange(len(edges)), 2)
    proposals = intersect(projections[camera[edges].ravel()], pixels[edges].reshape(-1, 2), owner, len(edges))
    degree = np.bincount(edges[:, 0], minlength=len(camera))
    start = np.cumsum(degree) - degree
    fans = degree[edges[:, 0]]
    proposer = np.repeat(np.arange(len(edges)), fans)
    voter = start[edges[proposer, 0]] + np.arange(len(proposer)) - np.repeat(np.cumsum(fans) - fans, fans)
    agrees = (
        reprojection_errors(projections, proposals[proposer], camera[edges[voter, 1]], pixels[edges[voter, 1]])
        < VOTE_PIXELS
    )
    at_home = reprojection_errors(projections, proposals, camera[edges[:, 0]], pixels[edges[:, 0]]) < VOTE_PIXELS
    votes = np.bincount(proposer[agrees], minlength=len(edges)) * at_home
    order = np.lexsort((-votes, edges[:, 0]))
    winners = order[np.unique(edges[order, 0], return_index=True)[1]]
    winners = winners[votes[winners] >= MIN_VIEWS - 1]
    point_of = np.full(len(edges), -1)
    point_of[winners] = np.arange(len(winners))
    chosen = agrees & (point_of[proposer] >= 0)
    point = np.concatenate([np.arange(len(winners)), point_of[proposer[chosen]]])
    feature = np.concatenate([edges[winners, 0], edges[voter[chosen], 1]])
    return _refine(cameras, projections, point, camera[feature], pixels[feature], colors[feature])


def _refine(
    cameras: list[Camera],
    projections: np.ndarray,
    point: np.ndarray,
    camera: np.ndarray,
    pixels: np.ndarray,
    colors: np.ndarray,
) -> Tracks:
    """Triangulate points from all their observations, and drop points that do not fit or are seen from one direction only."""
    count = int(point.max(initial=-1)) + 1
    points = intersect(projections[camera], pixels, point, count)
    fits = reprojection_errors(projections, points[point], camera, pixels) < REPROJECTION_PIXELS
    visible = np.zeros((count, len(cameras)), bool)
    visible[point[fits], camera[fits]] = True
    kept = (visible.sum(1) >= MIN_VIEWS) & (_widest_angle(cameras, points, visible) > np.radians(MIN_ANGLE_DEGREES))
    shade = np.zeros((count, 3))
    np.add.at(shade, point, colors / 255.0)
    shade /= np.maximum(np.bincount(point, minlength=count), 1)[:, None]
    return Tracks(points[kept], shade[kept].astype(np.float32), visible[kept])


def reprojection_errors(
    projections: np.ndarray, points: np.ndarray, camera: np.ndarray, pixels: np.ndarray
) -> np.ndarray:
    """Return reprojection errors [O], pixels; infinite behind the camera."""
    seen = np.einsum("oij,oj->oi", projections[camera, :, :3], points) + projections[camera, :, 3]
    depth = np.where(seen[:, 2] > 1e-9, seen[:, 2], np.nan)
    return np.nan_to_num(np.linalg.norm(seen[:, :2] / depth[:, None] - pixels, axis=1), nan=np.inf)


def intersect(projections: np.ndarray, pixels: np.ndarray, track: np.ndarray, count: int) -> np.ndarray:
    """Triangulate `count` points [count, 3] linearly. Observation o of point track[o] has projections[o] [3, 4] and pixels[o] [2]."""
    rows = pixels[:, :, None] * projections[:, 2:3] - projections[:, :2]
    rows /= np.maximum(np.linalg.norm(rows[..., :3], axis=-1, keepdims=True), 1e-12)
    normal = np.zeros((count, 4, 4))
    np.add.at(normal, track, np.einsum("oki,okj->oij", rows, rows))
    A = normal[:, :3, :3] + 1e-9 * np.eye(3)
    return np.linalg.solve(A, -normal[:, :3, 3:])[..., 0]


def _widest_angle(cameras: list[Camera], points: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Return the largest angle [P], radians, between a point's first ray and its other rays."""
    centers = np.stack([c.center for c in cameras]).astype(np.float64)
    rays = points[:, None] - centers
    rays /= np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-12)
    base = rays[np.arange(len(points)), visible.argmax(1)]
    cosine = np.where(visible, np.einsum("pci,pi->pc", rays, base), 1.0)
    return np.arccos(np.clip(cosine.min(1, initial=1.0), -1, 1))
