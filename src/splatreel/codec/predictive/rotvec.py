"""Rotation vectors: axis times angle in radians. For small rotations they are additive."""

from __future__ import annotations

import numpy as np
from numba import njit

from splatreel.jit import EXACT


def of_quats(quats: np.ndarray) -> np.ndarray:
    """Return vectors [T, N, 3] of unit quaternions [T, N, 4], choosing the equivalent rotation nearest to the frame before."""
    quats = np.where(quats[..., :1] < 0, -quats, quats)
    sine = np.linalg.norm(quats[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, quats[..., :1])
    vectors = np.where(sine > 1e-12, quats[..., 1:] / np.maximum(sine, 1e-12) * angle, 0.0)
    for frame in range(1, len(vectors)):
        now, before = vectors[frame], vectors[frame - 1]
        angle = np.linalg.norm(now, axis=-1, keepdims=True)
        axis = np.where(angle > 1e-9, now / np.maximum(angle, 1e-9), 0.0)
        turns = np.rint(((before * axis).sum(-1, keepdims=True) - angle) / (2 * np.pi))
        vectors[frame] = now + axis * (2 * np.pi * turns)
    return vectors


@njit(**EXACT)
def expand(vectors, turns):
    """Return unit quaternions [T, N, 4] float32 of vectors [T, N, 3] float32 about the world's axes.

    The result is about the axes that turns [N, 3, 3] made of the world's. Zero vectors are fast.
    """
    frames, count, _ = vectors.shape
    quats = np.empty((frames, count, 4), np.float32)
    for t in range(frames):
        for i in range(count):
            x, y, z = np.float64(vectors[t, i, 0]), np.float64(vectors[t, i, 1]), np.float64(vectors[t, i, 2])
            square = x * x + y * y + z * z
            w, share = 1.0, 0.5
            if square > 1e-20:
                angle = np.sqrt(square)
                w, share = np.cos(angle / 2), np.sin(angle / 2) / angle
            quats[t, i, 0] = w
            for k in range(3):
                quats[t, i, k + 1] = share * (turns[i, 0, k] * x + turns[i, 1, k] * y + turns[i, 2, k] * z)
    return quats
