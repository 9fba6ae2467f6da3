"""Section `shade`: changes of color and opacity over a group, encoded as motion is."""

from __future__ import annotations

import numpy as np

from splatreel.codec.predictive.klt import blocks, decode_klt, encode_klt
from splatreel.codec.predictive.points import COLORS
from splatreel.codec.predictive.precision import COLOR, Basis
from splatreel.codec.predictive.predictor import Predictor
from splatreel.codec.section import Sections, named, section_of

SHADE = np.diag([1.0, 1.0, 1.0, 2.0])
"""Transform of c_base and opacity for encoding. Opacity counts twice as much as color, about its effect in an image."""
SHADE[:3, :3] = COLORS
"""From c_base and opacity to what is coded: opacity counts twice as much as color, about what it changes in an image."""


def encode_shade(
    shade: np.ndarray, order: np.ndarray, predictor: Predictor, step: float, known: Basis | None = None
) -> Sections:
    """Encode changes of color and opacity [T, N, 4], given in the order of the input points. `known`: see `encode_klt`."""
    values = np.asarray(shade, np.float64)[:, order].transpose(1, 0, 2) @ SHADE.T
    return {"shade": encode_klt(COLOR, values, step, predictor, known)[0]}


def decode_shade(sections: Sections, frames: int, predictor: Predictor) -> np.ndarray:
    """Decode the changes, [T, N, 4] float32. Raise `ReelError` if the section is damaged."""
    count, back = len(predictor.classes), np.linalg.inv(SHADE).T.astype(np.float32)
    found = named("shade", decode_klt, COLOR, section_of(sections, "shade", "klt"), frames, 4, predictor)
    shade = np.empty((frames, count, 4), np.float32)
    for some in blocks(count, frames):
        shade[:, some] = found.expand(some) @ back
    return shade
