"""Points in the predictive codec: positions, shapes, opacities and colors as predicted, entropy coded integers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.codec.predictive import covariance
from splatreel.codec.predictive.klt import blocks, decode_klt, encode_klt, read_basis
from splatreel.codec.predictive.lod_prediction import MAX_CLASS, levels_of
from splatreel.codec.predictive.precision import (
    COLOR,
    MOTION,
    RELATIVE,
    SHAPE,
    STEPS,
    Precision,
    choose_precision,
)
from splatreel.codec.predictive.predictor import Predictor
from splatreel.codec.predictive.quantized_positions import (
    decode_quantized_positions,
    decode_refinement_bits,
    encode_quantized_positions,
    encode_refinement_bits,
)
from splatreel.codec.quantize import integer
from splatreel.codec.section import MAX_POINTS, Section, Sections, named, section_of
from splatreel.scene.gaussians import Gaussians

COLORS = np.array([[1, 1, 1], [1, 0, -1], [-1, 2, -1]]) / np.sqrt([[3], [2], [6]])
"""Orthonormal color transform: brightness, red against blue, green against both."""


@dataclass(frozen=True)
class EncodedPoints:
    """Sections of points and what the encoding of their offsets needs.

    Attributes:
        sections: Sections by name.
        order: Input point of each encoded point, [N].
        quats: Rotations of the encoded points, [N, 4].
        precision: Precision of the encoded points.
        predictor: Predictor of further sections.
    """

    sections: Sections
    order: np.ndarray
    quats: np.ndarray
    precision: Precision
    predictor: Predictor


def encode_points(gaussians: Gaussians, precision: Precision, directional: bool = True) -> EncodedPoints:
    """Encode finite points, N >= 1.

    Args:
        gaussians: Points to encode.
        precision: Their precision.
        directional: Keep view-dependent color.
    """
    gaussians.check_finite("Gaussians to encode")
    if len(gaussians) > MAX_POINTS:
        raise ReelError(f"{len(gaussians)} points are more than a file holds ({MAX_POINTS}).")
    finer, steps = precision.finer, precision.steps
    data, parameters, order, quantized = encode_quantized_positions(gaussians.means, precision.cell, precision.low)
    points, precision = gaussians[order], precision[order]
    classes, levels = precision.classes, levels_of(quantized)
    predictor = Predictor(levels, classes)
    refinement = encode_refinement_bits(points.means, parameters, quantized, np.maximum(finer - classes[:, MOTION], 0))
    shapes = covariance.of_shapes(points.quats, points.scales)
    sections = {
        "means": Section(data, parameters | {"finer": finer}),
        "classes": Predictor(levels, np.zeros_like(classes)).encode(SHAPE, classes - classes[:, :1] * RELATIVE, 1.0),
        "places": Section(refinement, {"codec": "plain"}),
        "shapes": predictor.encode(SHAPE, shapes, steps["shapes"]),
        "opacities": predictor.encode(SHAPE, points.opacities[:, None], steps["opacities"]),
        "sh_base": predictor.encode(COLOR, points.sh[:, 0] @ COLORS.T, steps["sh_base"]),
    }
    if points.sh_degree and directional:
        rest = points.sh[:, 1:].reshape(len(points), -1).astype(np.float64)
        section, _ = encode_klt(COLOR, rest[:, :, None], steps["sh_rest"], predictor, precision.bases.get("sh_rest"))
        sections["sh_rest"] = Section(section.data, section.parameters | {"degree": points.sh_degree})
    return EncodedPoints(sections, order, points.quats, precision, predictor)


def read_precision(sections: Sections, frames: int, predictor: Predictor) -> Precision:
    """Return the precision of a file whose sections were decoded without an error."""
    means = sections["means"].parameters
    steps = choose_precision(np.ones((1, 3)), None, 1.0, True, STEPS).steps
    steps = {name: sections[name].parameters["step"] if name in sections else step for name, step in steps.items()}
    degree = sections["sh_rest"].parameters["degree"] if "sh_rest" in sections else 0
    rest = 3 * ((degree + 1) ** 2 - 1)
    forms = {
        "sh_rest": (COLOR, rest, 1),
        "dx": (MOTION, frames, 3),
        "dq": (MOTION, frames, 3),
        "shade": (COLOR, frames, 4),
    }
    bases = {
        name: read_basis(kind, sections[name], dimensions, channels, predictor)
        for name, (kind, dimensions, channels) in forms.items()
        if name in sections
    }
    return Precision(predictor.classes, steps, means["step"], means["finer"], np.array(means["min"]), bases)


def decode_points(sections: Sections, count: int) -> tuple[Gaussians, Predictor]:
    """Decode the `count` >= 1 points of a file. Raise `ReelError` with the name of the damaged section."""
    section = section_of(sections, "means", "lattice")
    quantized = named("means", decode_quantized_positions, section.data, section.parameters, count)
    finer = named("means", integer, section.parameters, "finer", 0, MAX_CLASS)
    levels = levels_of(quantized)
    flat = Predictor(levels, np.zeros((count, 3), np.int64))
    classes = flat.decode(SHAPE, sections, "classes", 3).astype(np.int64)
    classes += classes[:, :1] * RELATIVE
    if (classes < 0).any() or (classes > MAX_CLASS).any():
        raise ReelError(f"section 'classes' has classes outside 0..{MAX_CLASS}.")
    predictor = Predictor(levels, classes)
    bits = np.maximum(finer - classes[:, MOTION], 0)
    means = named(
        "places",
        decode_refinement_bits,
        section_of(sections, "places", "plain").data,
        section.parameters,
        quantized,
        bits,
    )
    quats, scales = covariance.to_shapes(predictor.decode(SHAPE, sections, "shapes", covariance.NUMBERS))
    opacities = np.clip(predictor.decode(SHAPE, sections, "opacities", 1)[:, 0], 0, 1)
    base = predictor.decode(COLOR, sections, "sh_base", 3) @ COLORS
    sh = _decode_rest(sections, predictor)
    sh[:, 0] = base
    return Gaussians(means, quats, scales, opacities, sh), predictor


def _decode_rest(sections: Sections, predictor: Predictor) -> np.ndarray:
    """Decode spherical harmonics [N, (degree + 1)^2, 3] float32; the first coefficient is left uninitialized."""
    count = len(predictor.classes)
    if "sh_rest" not in sections:
        return np.empty((count, 1, 3), np.float32)
    section = section_of(sections, "sh_rest", "klt")
    numbers = (named("sh_rest", integer, section.parameters, "degree", 1, 3) + 1) ** 2
    found = named("sh_rest", decode_klt, COLOR, section, 3 * (numbers - 1), 1, predictor)
    sh = np.empty((count, numbers, 3), np.float32)
    for some in blocks(count, numbers):
        sh[some, 1:] = found.expand(some)[:, :, 0].T.reshape(-1, numbers - 1, 3)
    return sh
