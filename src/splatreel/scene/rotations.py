"""Unit quaternions (wxyz) and rotation matrices in numpy."""

from __future__ import annotations

import numpy as np


def normalize(quats: np.ndarray) -> np.ndarray:
    """Normalize quaternions [..., 4]. A zero quaternion becomes the identity."""
    norm = np.linalg.norm(quats, axis=-1, keepdims=True)
    identity = np.zeros_like(quats)
    identity[..., 0] = 1
    return np.where(norm > 1e-12, quats / np.maximum(norm, 1e-12), identity)


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Hamilton product a * b of quaternions [..., 4]."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def conjugate(quats: np.ndarray) -> np.ndarray:
    """Return the inverses of unit quaternions [..., 4]."""
    return quats * np.array([1, -1, -1, -1], quats.dtype)


def to_matrix(quats: np.ndarray) -> np.ndarray:
    """Convert unit quaternions [..., 4] to rotation matrices [..., 3, 3]."""
    w, x, y, z = np.moveaxis(quats, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)
