"""Rotation of a whole scene, so that exported files stand upright where they are opened."""

from __future__ import annotations

import numpy as np

from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians

_SAMPLES = 64
"""Directions that determine the rotation of harmonics."""


def turn_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the smallest rotation, [4] wxyz, that takes one direction [3] to another.

    Opposite directions are half a turn apart about x, or about y if they are along x.
    """
    a, b = (np.asarray(v, np.float64) / np.linalg.norm(v) for v in (start, end))
    if a @ b < -0.999999:
        across = np.eye(3)[0 if abs(a[0]) < 0.9 else 1]
        across -= (across @ a) * a
        return np.concatenate([[0.0], across / np.linalg.norm(across)])
    quat = np.concatenate([[1 + a @ b], np.cross(a, b)])
    return quat / np.linalg.norm(quat)


def turn_upright(up: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the rotation, [4] wxyz, that takes an up direction [3] to an axis [3].

    The direction first turns to the nearest axis, then from axis to axis. So scenes that are slightly tilted keep the same
    side in front, whatever axis is up.
    """
    nearest = np.zeros(3)
    nearest[np.abs(up).argmax()] = np.sign(up[np.abs(up).argmax()])
    return rotations.multiply(turn_between(nearest, end), turn_between(up, nearest))


def turned(points: Gaussians, quat: np.ndarray) -> Gaussians:
    """Return Gaussians rotated about the origin by a unit quaternion [4] wxyz, with their view-dependent colors."""
    quat = np.asarray(quat, np.float64)
    if abs(quat[0]) == 1:
        return points
    matrix = rotations.to_matrix(quat)
    quats = rotations.multiply(np.broadcast_to(quat, points.quats.shape), points.quats)
    sh = points.sh.copy()
    for degree in range(1, points.sh_degree + 1):
        band = slice(degree**2, (degree + 1) ** 2)
        sh[:, band] = np.einsum("ij,njc->nic", _turn_of_band(matrix, degree), points.sh[:, band])
    return Gaussians(points.means @ matrix.T, quats, points.scales, points.opacities, sh)


def _turn_of_band(matrix: np.ndarray, degree: int) -> np.ndarray:
    """Return the matrix that rotates the coefficients of a degree, found from the values in many directions."""
    directions = np.random.default_rng(0).normal(size=(_SAMPLES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found, *_ = np.linalg.lstsq(_band(directions, degree), _band(directions @ matrix, degree))
    return np.where(np.abs(found) < 1e-9, 0, found)


def _band(directions: np.ndarray, degree: int) -> np.ndarray:
    """Return the harmonics of degree 1 to 3 in unit directions [D, 3], [D, 2 * degree + 1], up to common factors."""
    x, y, z = directions.T
    if degree == 1:
        return np.stack([-y, z, -x], 1)
    if degree == 2:
        root = np.sqrt(3)
        across = [x * y, -y * z, (2 * z * z - x * x - y * y) / (2 * root), -x * z, (x * x - y * y) / 2]
        return np.stack(across, 1)
    return np.stack(
        [
            -np.sqrt(10) * y * (3 * x * x - y * y),
            np.sqrt(240) * x * y * z,
            -np.sqrt(6) * y * (4 * z * z - x * x - y * y),
            2 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -np.sqrt(6) * x * (4 * z * z - x * x - y * y),
            np.sqrt(60) * z * (x * x - y * y),
            -np.sqrt(10) * x * (x * x - 3 * y * y),
        ],
        1,
    )
