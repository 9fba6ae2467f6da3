"""Sparse points from feature matches between cameras with known poses.

Only features near each other's epipolar line are compared. Repeated texture then does less harm than in matching without poses,
and more weak features survive. Two-view matches are often false, so a point must be seen by three cameras.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.method.init.features import detect, match
from splatreel.scene.camera import Camera

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

    Args:
        cameras: All cameras.
        images: [C, H, W, 3] uint8.
        neighbors: Number of neighbors that each camera is matched with.
    """
    features = [detect(image) for image in images]
    first = np.cumsum([0] + [len(f.pixels) for f in features])
    edges: list[np.ndarray] = [np.zeros((0, 2), np.int64)]
    for i, j in neighbor_pairs(cameras, neighbors):
        matches = match(cameras[i], cameras[j], features[i], features[j], EPIPOLAR_PIXELS)
        edges.append(matches + np.array([first[i], first[j]]))
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

    Args:
        cameras: All cameras.
        edges: [E, 2] int feature indices, both directions.
        camera: [F] int, camera of each feature.
        pixels: [F, 2] features.
        colors: [F, 3] uint8.
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
    """Triangulate points from all their observations, and drop points that do not fit or are seen from one direction only.

    Args:
        cameras: All cameras.
        projections: [C, 3, 4] projection matrices.
        point: [O] int, point of every observation.
        camera: [O] int, camera of every observation.
        pixels: [O, 2] observations.
        colors: [O, 3] uint8.
    """
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
    """Return reprojection errors [O], pixels; infinite behind the camera.

    Args:
        projections: [C, 3, 4] projection matrices.
        points: [O, 3] world.
        camera: [O] int.
        pixels: [O, 2] observations.
    """
    seen = np.einsum("oij,oj->oi", projections[camera, :, :3], points) + projections[camera, :, 3]
    depth = np.where(seen[:, 2] > 1e-9, seen[:, 2], np.nan)
    return np.nan_to_num(np.linalg.norm(seen[:, :2] / depth[:, None] - pixels, axis=1), nan=np.inf)


def intersect(projections: np.ndarray, pixels: np.ndarray, track: np.ndarray, count: int) -> np.ndarray:
    """Triangulate `count` points linearly; [count, 3].

    Args:
        projections: [O, 3, 4] projection matrix of every observation.
        pixels: [O, 2] observations.
        track: [O] int, point of every observation.
        count: Number of points.
    """
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
