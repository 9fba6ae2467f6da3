"""Image features, and their matches between cameras with known poses."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

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
    """Return mutual best matches near the epipolar lines that pass the ratio test.

    Args:
        camera_a: First camera.
        camera_b: Second camera.
        a: Features of the first image.
        b: Features of the second image.
        reach: Maximum distance from the line, pixels, for all pairs or for each pair [A, B].

    Returns:
        [M, 2] int indices into a and b.
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
