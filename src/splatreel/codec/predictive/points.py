"""Points in the predictive codec: positions, shapes, opacities, colors and their motion as predicted, entropy coded integers.

Positions are differences of Morton codes, which are small because the points are sorted by them. Refinement bits give the position
of a point within its grid cell. Important points have more of them.

The shape of a Gaussian is six numbers: the logarithm of the square root of its covariance, R diag(log2 s) R^T. They do not depend
on the order or the sign of the axes. A rotation changes them more for longer Gaussians, and neighbors on a surface have similar
numbers. They are coordinates in an orthonormal basis of the symmetric matrices, except that the size counts sqrt 2 times as much.

Motion and changes of color over a group are few coefficients in the group's own basis (`klt`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from splatreel.base.errors import ReelError
from splatreel.base.jit import EXACT
from splatreel.codec.container import MAX_POINTS, Section, Sections, named, section_of
from splatreel.codec.predictive.entropy import Stream, entropy_encode
from splatreel.codec.predictive.klt import blocks, decode_klt, encode_klt, read_basis
from splatreel.codec.predictive.lod_prediction import MAX_CLASS, Predictor, levels_of
from splatreel.codec.predictive.precision import (
    COLOR,
    MOTION,
    RELATIVE,
    SHAPE,
    STEPS,
    Basis,
    Precision,
    choose_precision,
)
from splatreel.codec.quantize import Parameters, integer, number, numbers
from splatreel.scene import morton, rotations
from splatreel.scene.gaussians import Gaussians

_SHAPE_NUMBERS = 6
LARGEST_OCTAVE = 126
"""Maximum absolute octave that float32 holds."""
_XX, _XY, _XZ, _YY, _YZ, _ZZ = range(6)
_X, _Y, _Z = 1, 2, 3
_SWEEPS = 12
_NOTHING = 1e-18
"""Share of a matrix's squared norm that off-diagonal elements may keep, far below float32 precision."""


def shape_numbers(quats: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return [N, 6] float64 of rotations [N, 4] and scales [N, 3]: size, x against y, z against both, then xy, xz, yz."""
    turns = rotations.to_matrix(rotations.normalize(quats.astype(np.float64)))
    octaves = np.log2(np.maximum(scales.astype(np.float64), 1e-30))
    xx, xy, xz, _, yy, yz, _, _, zz = ((turns * octaves[:, None]) @ turns.transpose(0, 2, 1)).reshape(-1, 9).T
    parts = (xx + yy + zz) * np.sqrt(2 / 3), (xx - yy) / np.sqrt(2), (2 * zz - xx - yy) / np.sqrt(6)
    return np.stack([*parts, xy * np.sqrt(2), xz * np.sqrt(2), yz * np.sqrt(2)], 1)


@njit(**EXACT)
def shapes_of_numbers(numbers):
    """Return unit quaternions [N, 4] and scales [N, 3], float64, of numbers [N, 6], by Jacobi rotations in the order of the format."""
    count = len(numbers)
    quats, scales = np.empty((count, 4)), np.empty((count, 3))
    root2, root6 = np.sqrt(2.0), np.sqrt(6.0)
    m, q = np.empty(6), np.empty(4)
    for i in range(count):
        size, across, along = numbers[i, 0] / root6, numbers[i, 1] / root2, numbers[i, 2] / root6
        m[_XX], m[_YY], m[_ZZ] = size - along + across, size - along - across, size + 2 * along
        m[_XY], m[_XZ], m[_YZ] = numbers[i, 3] / root2, numbers[i, 4] / root2, numbers[i, 5] / root2
        q[0], q[1], q[2], q[3] = 1.0, 0.0, 0.0, 0.0
        _diagonalize(m, q)
        quats[i] = q / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        for k, octaves in enumerate((m[_XX], m[_YY], m[_ZZ])):
            scales[i, k] = 2.0 ** min(max(octaves, -LARGEST_OCTAVE), LARGEST_OCTAVE)
    return quats, scales


@njit(**EXACT)
def _diagonalize(m, q):
    """Rotate the axes of m until it is diagonal; q becomes that rotation."""
    for _ in range(_SWEEPS):
        rest = m[_XY] * m[_XY] + m[_XZ] * m[_XZ] + m[_YZ] * m[_YZ]
        whole = m[_XX] * m[_XX] + m[_YY] * m[_YY] + m[_ZZ] * m[_ZZ]
        if rest <= _NOTHING * whole:
            return
        _turn(m, q, _XX, _YY, _XY, _XZ, _YZ, _X, _Y, _Z)
        _turn(m, q, _ZZ, _XX, _XZ, _YZ, _XY, _Z, _X, _Y)
        _turn(m, q, _YY, _ZZ, _YZ, _XY, _XZ, _Y, _Z, _X)


@njit(**EXACT)
def _turn(m, q, aa, bb, ab, ac, bc, a, b, c):
    """Rotate about axis c so that m becomes zero at axes a and b. The other arguments are the positions of these axes in m and q."""
    off = m[ab]
    if off == 0:
        return
    half = (m[bb] - m[aa]) / (2 * off)
    tangent = 1 / (abs(half) + np.sqrt(half * half + 1))
    if half < 0:
        tangent = -tangent
    cosine = 1 / np.sqrt(tangent * tangent + 1)
    sine = tangent * cosine
    m[aa], m[bb], m[ab] = m[aa] - tangent * off, m[bb] + tangent * off, 0.0
    m[ac], m[bc] = cosine * m[ac] - sine * m[bc], sine * m[ac] + cosine * m[bc]
    # The new axes are cosine a - sine b and sine a + cosine b: a rotation about c by the negative angle, multiplied from the right.
    w = np.sqrt((1 + cosine) / 2)
    v = -sine / (2 * w)
    q[0], q[a], q[b], q[c] = w * q[0] - v * q[c], w * q[a] + v * q[b], w * q[b] - v * q[a], w * q[c] + v * q[0]


MAX_BITS = 17
"""Bits per axis. A code then fits into a double, the number type of browsers."""


def encode_quantized_positions(
    means: np.ndarray, step: float, low: np.ndarray | None = None
) -> tuple[bytes, Parameters, np.ndarray, np.ndarray]:
    """Encode positions means [N, 3], N >= 1, as multiples of a step, or of the smallest step that 17 bits per axis allow.

    `low` is the origin [3] of the grid, at or below all positions; None uses their low corner.

    Returns:
        The bytes, the parameters, order [N] (the input point that is decoded as point i), and the quantized positions
        [N, 3] int64.
    """
    means = np.asarray(means, np.float64)
    low = np.asarray(means.min(0) if low is None else low, np.float64)
    step = max(step, float((means.max(0) - low).max()) / ((1 << MAX_BITS) - 1), 1e-30)
    quantized = np.maximum(np.rint((means - low) / step), 0).astype(np.int64)
    codes = morton.encode(quantized).astype(np.int64)
    order = np.argsort(codes, kind="stable")
    data = entropy_encode(np.diff(codes[order], prepend=0), np.zeros(len(order), np.int64), 1)
    return data, {"codec": "lattice", "min": low.tolist(), "step": step}, order, quantized[order]


def decode_quantized_positions(data: bytes, parameters: Parameters, count: int) -> np.ndarray:
    """Decode the quantized positions [count, 3] int64. Raise `ReelError` if the section is damaged."""
    _cells(parameters)
    stream = Stream(data, 1)
    codes = np.cumsum(stream.read(count))
    stream.finish()
    if (codes < 0).any() or (codes >> 3 * MAX_BITS).any():
        raise ReelError("decodes to positions outside of its lattice.")
    return morton.decode(codes)


def encode_refinement_bits(means: np.ndarray, parameters: Parameters, quantized: np.ndarray, bits: np.ndarray) -> bytes:
    """Encode in which of 2^bits [N] parts along each axis of its cell every point of means [N, 3] lies."""
    within = (np.asarray(means, np.float64) - parameters["min"]) / parameters["step"] - quantized + 0.5
    parts = 1 << bits[:, None]
    refinement = np.clip(np.floor(within * parts), 0, parts - 1).astype(np.int64)
    planes = [(refinement[bits > b] >> b & 1).ravel() for b in range(int(bits.max(initial=0)))]
    return np.packbits(np.concatenate([np.zeros(0, np.int64), *planes]).astype(bool), bitorder="little").tobytes()


def decode_refinement_bits(data: bytes, parameters: Parameters, quantized: np.ndarray, bits: np.ndarray) -> np.ndarray:
    """Return positions [N, 3] float32 at the centers of the encoded parts of their cells. Raise `ReelError` for a wrong length."""
    low, step = _cells(parameters)
    if len(data) != (3 * int(bits.sum()) + 7) // 8:
        raise ReelError(f"holds {len(data)} bytes where its points have {3 * int(bits.sum())} bits.")
    plain, used = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little"), 0
    refinement = np.zeros(quantized.shape, np.int64)
    for b in range(int(bits.max(initial=0))):
        finer = bits > b
        count = 3 * int(finer.sum())
        refinement[finer] |= plain[used : used + count].reshape(-1, 3).astype(np.int64) << b
        used += count
    parts = 1 << bits[:, None]
    return (low + (quantized + (2 * refinement + 1 - parts) / (2 * parts)) * step).astype(np.float32)


def _cells(parameters: Parameters) -> tuple[np.ndarray, float]:
    """Return origin and cell width of the grid of quantized positions. Raise `ReelError` if they are invalid."""
    return numbers(parameters, "min", 3), number(parameters, "step", 1e-30, 1e30)


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

    `directional`: Keep view-dependent color.
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
    shapes = shape_numbers(points.quats, points.scales)
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
    quats, scales = shapes_of_numbers(predictor.decode(SHAPE, sections, "shapes", _SHAPE_NUMBERS))
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
        dq[:, some] = _expand_rotation_vectors(found.expand(some), turns)
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
def _expand_rotation_vectors(vectors, turns):
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


_SHADE = np.diag([1.0, 1.0, 1.0, 2.0])
"""Transform of c_base and opacity for encoding. Opacity counts twice as much as color, about its effect in an image."""
_SHADE[:3, :3] = COLORS
"""From c_base and opacity to what is coded: opacity counts twice as much as color, about what it changes in an image."""


def encode_shade(
    shade: np.ndarray, order: np.ndarray, predictor: Predictor, step: float, known: Basis | None = None
) -> Sections:
    """Encode changes of color and opacity [T, N, 4], given in the order of the input points. `known`: see `encode_klt`."""
    values = np.asarray(shade, np.float64)[:, order].transpose(1, 0, 2) @ _SHADE.T
    return {"shade": encode_klt(COLOR, values, step, predictor, known)[0]}


def decode_shade(sections: Sections, frames: int, predictor: Predictor) -> np.ndarray:
    """Decode the changes, [T, N, 4] float32. Raise `ReelError` if the section is damaged."""
    count, back = len(predictor.classes), np.linalg.inv(_SHADE).T.astype(np.float32)
    found = named("shade", decode_klt, COLOR, section_of(sections, "shade", "klt"), frames, 4, predictor)
    shade = np.empty((frames, count, 4), np.float32)
    for some in blocks(count, frames):
        shade[:, some] = found.expand(some) @ back
    return shade
