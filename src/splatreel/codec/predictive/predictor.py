"""Sections with predicted values of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.codec.predictive.lod_prediction import Levels, decode_lod, encode_lod, levels_of
from splatreel.codec.quantize import number
from splatreel.codec.section import Section, Sections, named, section_of


@dataclass(frozen=True)
class Predictor:
    """Encoder and decoder of predicted values of points.

    Attributes:
        levels: Levels of the points.
        classes: Classes of shape, color and motion, [N, 3] int64, see `precision.classes_of`.
    """

    levels: Levels
    classes: np.ndarray

    def encode(self, kind: int, values: np.ndarray, step: float) -> Section:
        """Encode values [N, C] as a section."""
        data, _ = encode_lod(values / step, self.levels, self.classes[:, kind])
        return Section(data, {"codec": "field", "step": step})

    def decode(self, kind: int, sections: Sections, name: str, columns: int) -> np.ndarray:
        """Decode values [N, C] float64. Raise `ReelError` if the section is damaged."""
        section = section_of(sections, name, "field")
        step = named(name, number, section.parameters, "step", 1e-30, 1e30)
        shape = len(self.classes), columns
        return named(name, decode_lod, section.data, shape, self.levels, self.classes[:, kind]) * step

    @classmethod
    def in_file_order(cls, count: int) -> Predictor:
        """Return the predictor for points in the paper's coding: each is predicted from its neighbors in the file, all of class 0."""
        positions = np.zeros((count, 3), np.int64)
        positions[:, 0] = np.arange(count)
        return cls(levels_of(positions), np.zeros((count, 3), np.int64))
