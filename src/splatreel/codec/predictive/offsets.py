"""Offsets in the predictive codec: motion over a group as few coefficients in the group's own basis."""

from __future__ import annotations

import numpy as np
from numba import njit

from splatreel.base.jit import EXACT
from splatreel.codec.predictive.klt import blocks, decode_klt, encode_klt
from splatreel.codec.predictive.points import EncodedPoints
from splatreel.codec.predictive.precision import MOTION
from splatreel.codec.predictive.predictor import Predictor
from splatreel.codec.section import Section, Sections, named, section_of
from splatreel.scene import rotations


def encode_offsets(dx: np.ndarray, dq: np.ndarray, points: EncodedPoints) -> Sections:
    """Encode the sections `dx` and `dq`.

    Rotations are stored about the world's axes, because neighbors turn alike about them. Each section is decoded again,
    and its largest error is stored: of a coordinate in world units, or of a rotation in radians.

    Args:
        dx: Position offsets, [T, N, 3], in the order of the input points.
        dq: Rotation offsets, [T, N, 4], in the order of the input points.
        points: Encoded points.
    """
    predictor, precision = points.predictor, points.precision
    moves = np.asarray(dx, np.float64)[:, points.order].transpose(1, 0, 2)
    vectors = rotation_vectors(rotations.normalize(np.asarray(dq, np.float64))[:, points.order]).transpose(1, 0, 2)
    vectors = vectors @ rotations.to_matrix(rotations.normalize(points.quats.astype(np.float64))).transpose(0, 2, 1)
    sections: Sections = {}
    for name, values in {"dx": moves, "dq": vectors}.items():
        section, decoded = encode_klt(MOTION, values, precision.steps[name], predictor, precision.bases.get(name))
        error = float(np.abs(decoded - values.transpose(1, 0, 2)).max())
        sections[name] = Section(section.data, section.parameters | {"error": error})
    return sections


def decode_offsets(
    sections: Sections, frames: int, quats: np.ndarray, predictor: Predictor
) -> tuple[np.ndarray, np.ndarray]:
    """Decode dx [T, N, 3] and unit dq [T, N, 4], float32, of points with rotations quats [N, 4]. Raise `ReelError` if damaged."""
    count = len(quats)
    dx = named("dx", decode_klt, MOTION, section_of(sections, "dx", "klt"), frames, 3, predictor).expand(
        slice(0, count)
    )
    found = named("dq", decode_klt, MOTION, section_of(sections, "dq", "klt"), frames, 3, predictor)
    dq = np.empty((frames, count, 4), np.float32)
    for some in blocks(count, frames):
        turns = rotations.to_matrix(quats[some].astype(np.float64))
        dq[:, some] = expand_rotation_vectors(found.expand(some), turns)
    return dx, dq


def rotation_vectors(quats: np.ndarray) -> np.ndarray:
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
def expand_rotation_vectors(vectors, turns):
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
