"""Offsets in the predictive codec: motion over a group as few coefficients in the group's own basis."""

from __future__ import annotations

import numpy as np

from splatreel.codec.predictive import rotvec
from splatreel.codec.predictive.klt_section import blocks, decode_klt, encode_klt
from splatreel.codec.predictive.points import EncodedPoints
from splatreel.codec.predictive.precision import MOTION, Steps
from splatreel.codec.predictive.predictor import Predictor
from splatreel.codec.section import Section, Sections, named, section_of
from splatreel.config import EncodeConfig
from splatreel.scene import rotations


def encode_offsets(
    dx: np.ndarray, dq: np.ndarray, points: EncodedPoints, config: EncodeConfig, steps: Steps
) -> Sections:
    """Encode the sections `dx` and `dq`.

    Rotations are stored about the world's axes, because neighbors turn alike about them. Each section is decoded again,
    and its largest error is stored: of a coordinate in world units, or of a rotation in radians.

    Args:
        dx: Position offsets, [T, N, 3], in the order of the input points.
        dq: Rotation offsets, [T, N, 4], in the order of the input points.
        points: Encoded points.
        config: Encoding settings.
        steps: Quantization steps at a coarseness of 1.
    """
    predictor = points.predictor
    moves = np.asarray(dx, np.float64)[:, points.order].transpose(1, 0, 2)
    vectors = rotvec.of_quats(rotations.normalize(np.asarray(dq, np.float64))[:, points.order]).transpose(1, 0, 2)
    vectors = vectors @ rotations.to_matrix(rotations.normalize(points.quats.astype(np.float64))).transpose(0, 2, 1)
    sections: Sections = {}
    offsets = {"dx": (moves, steps.motion * points.size), "dq": (vectors, steps.turn)}
    for name, (values, step) in offsets.items():
        section, decoded = encode_klt(MOTION, values, step * config.coarseness, predictor)
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
        dq[:, some] = rotvec.expand(found.expand(some), turns)
    return dx, dq
