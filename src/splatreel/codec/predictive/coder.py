"""Our own codec: points and offsets as whole numbers predicted from neighbours and entropy coded. No Draco, no video decoder.

Every quantity is a multiple of a step. Points that hardly show get steps that are a power of two larger; which one is their class,
and is sent (docs/format.md).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from splatreel.codec.predictive import covariance, klt, rotvec
from splatreel.codec.predictive.entropy import encode
from splatreel.codec.predictive.lod_prediction import MAX_CLASS, Levels, decode_field, encode_field, ends_of, levels_of
from splatreel.codec.predictive.quantized_positions import (
    decode_places,
    decode_positions,
    encode_places,
    encode_positions,
)
from splatreel.codec.quantize import integer, number
from splatreel.codec.sections import MAX_POINTS, Section, Sections, named, section_of
from splatreel.config import EncodeConfig
from splatreel.errors import ReelError
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians

COLORS = np.array([[1, 1, 1], [1, 0, -1], [-1, 2, -1]]) / np.sqrt([[3], [2], [6]])
"""Orthonormal: brightness, red against blue, green against both."""
_STREAMS = struct.Struct("<IIII")
_SOME = 1 << 18
"""Values that are worked on at a time."""


@dataclass(frozen=True)
class Steps:
    """Steps of the most important points at `EncodeConfig.coarseness` 1.

    position and motion are in multiples of the points' typical size, turn is in radians, shape in octaves (`covariance`).
    """

    position: float = 0.028
    motion: float = 0.18
    turn: float = 0.06
    shape: float = 0.065
    opacity: float = 0.01
    color: float = 0.025
    rest: float = 0.016
    shade: float = 0.12


STEPS = Steps()
SHADE = np.diag([1.0, 1.0, 1.0, 2.0])
SHADE[:3, :3] = COLORS
"""From c_base and opacity to what is coded: opacity counts twice as much as colour, about what it changes in a picture."""
FOLLOW = np.array([1.0, 1.0, 0.85])
"""How far the steps of shape, colour and motion follow importance; less than 1 was better for motion on views held out."""
COARSEST = 3, 2
"""The largest class an encoder gives at a coarseness up to 1, and above: what hardly shows now would show, were it off by too much."""
SHAPE, COLOR, MOTION = range(3)
RELATIVE = np.array([0, 1, 1])
"""Classes of colour and motion are stored less that of shape, since what hardly shows hardly shows in any way."""


@dataclass(frozen=True)
class Neighbourhood:
    """What decoding the values of points needs to know of them. classes: [N, 3] int64, of shape, colour and motion."""

    levels: Levels
    classes: np.ndarray

    def encode(self, kind: int, values: np.ndarray, step: float) -> Section:
        """Values [N, C] as a section."""
        data, _ = encode_field(values / step, self.levels, self.classes[:, kind])
        return Section(data, {"codec": "field", "step": step})

    def decode(self, kind: int, sections: Sections, name: str, columns: int) -> np.ndarray:
        """Values [N, C] float64. Raises `ReelError`."""
        section = section_of(sections, name, "field")
        step = named(name, number, section.parameters, "step", 1e-30, 1e30)
        shape = len(self.classes), columns
        return named(name, decode_field, section.data, shape, self.levels, self.classes[:, kind]) * step


def classes_of(importance: np.ndarray | None, count: int, coarseness: float = 1.0) -> np.ndarray:
    """Classes [N, 3] int64: steps grow as importance [N, 3] falls, from that of the tenth of the points that matters most."""
    if importance is None:
        return np.zeros((count, 3), np.int64)
    top = np.maximum(np.quantile(importance, 0.9, axis=0), 1e-30)
    octaves = np.log2(top / np.maximum(importance, top * 1e-6))
    return np.clip(np.rint(octaves * FOLLOW), 0, COARSEST[coarseness > 1]).astype(np.int64)


@dataclass(frozen=True)
class EncodedPoints:
    """Sections of points; order [N]: the input point of each encoded one. quats: theirs, [N, 4]. size: typical, world units."""

    sections: Sections
    order: np.ndarray
    quats: np.ndarray
    size: float
    neighbourhood: Neighbourhood


def encode_points(
    gaussians: Gaussians, importance: np.ndarray | None, config: EncodeConfig, moving: bool = True
) -> EncodedPoints:
    """Encode points, N >= 1, finite. importance: [N, 3] >= 0, see `classes_of`; None: all alike. moving: offsets will follow."""
    gaussians.check_finite("Gaussians to encode")
    if len(gaussians) > MAX_POINTS:
        raise ReelError(f"{len(gaussians)} points are more than a file holds ({MAX_POINTS}).")
    coarse = config.coarseness
    size = float(np.exp(np.median(np.log(np.maximum(gaussians.scales, 1e-30)))))
    finer = COARSEST[coarse > 1]
    step = STEPS.position * coarse * size
    data, parameters, order, lattice = encode_positions(gaussians.means, step * 2**finer)
    points = gaussians[order]
    classes = classes_of(None if importance is None else importance[order], len(order), coarse)
    if not moving:
        classes[:, MOTION] = classes[:, SHAPE]
    levels = levels_of(lattice)
    here = Neighbourhood(levels, classes)
    places = encode_places(points.means, parameters, lattice, np.maximum(finer - classes[:, MOTION], 0))
    shapes = covariance.of_shapes(points.quats, points.scales)
    sections = {
        "means": Section(data, parameters | {"finer": finer}),
        "classes": Neighbourhood(levels, np.zeros_like(classes)).encode(
            SHAPE, classes - classes[:, :1] * RELATIVE, 1.0
        ),
        "places": Section(places, {"codec": "plain"}),
        "shapes": here.encode(SHAPE, shapes, STEPS.shape * coarse),
        "opacities": here.encode(SHAPE, points.opacities[:, None], STEPS.opacity * coarse),
        "sh_base": here.encode(COLOR, points.sh[:, 0] @ COLORS.T, STEPS.color * coarse),
    }
    if points.sh_degree and config.sh_entries:
        rest = points.sh[:, 1:].reshape(len(points), -1).astype(np.float64)
        section, _ = _encode_klt(COLOR, rest[:, :, None], STEPS.rest * coarse, here)
        sections["sh_rest"] = Section(section.data, section.parameters | {"degree": points.sh_degree})
    return EncodedPoints(sections, order, points.quats, size, here)


def decode_points(sections: Sections, count: int) -> tuple[Gaussians, Neighbourhood]:
    """The `count` >= 1 points of a file's sections. Raises `ReelError` that names the section."""
    section = section_of(sections, "means", "lattice")
    lattice = named("means", decode_positions, section.data, section.parameters, count)
    finer = named("means", integer, section.parameters, "finer", 0, MAX_CLASS)
    levels = levels_of(lattice)
    flat = Neighbourhood(levels, np.zeros((count, 3), np.int64))
    classes = flat.decode(SHAPE, sections, "classes", 3).astype(np.int64)
    classes += classes[:, :1] * RELATIVE
    if (classes < 0).any() or (classes > MAX_CLASS).any():
        raise ReelError(f"section 'classes' has classes outside 0..{MAX_CLASS}.")
    here = Neighbourhood(levels, classes)
    bits = np.maximum(finer - classes[:, MOTION], 0)
    means = named(
        "places", decode_places, section_of(sections, "places", "plain").data, section.parameters, lattice, bits
    )
    quats, scales = covariance.to_shapes(here.decode(SHAPE, sections, "shapes", covariance.NUMBERS))
    opacities = np.clip(here.decode(SHAPE, sections, "opacities", 1)[:, 0], 0, 1)
    base = here.decode(COLOR, sections, "sh_base", 3) @ COLORS
    sh = _decode_rest(sections, here)
    sh[:, 0] = base
    return Gaussians(means, quats, scales, opacities, sh), here


def _decode_rest(sections: Sections, here: Neighbourhood) -> np.ndarray:
    """Spherical harmonics [N, (degree + 1)^2, 3] float32, the first of which is still open. Raises `ReelError`."""
    count = len(here.classes)
    if "sh_rest" not in sections:
        return np.empty((count, 1, 3), np.float32)
    section = section_of(sections, "sh_rest", "klt")
    numbers = (named("sh_rest", integer, section.parameters, "degree", 1, 3) + 1) ** 2
    found = named("sh_rest", _decode_klt, COLOR, section, 3 * (numbers - 1), 1, here)
    sh = np.empty((count, numbers, 3), np.float32)
    for some in _blocks(count, numbers):
        sh[some, 1:] = found.expand(some)[:, :, 0].T.reshape(-1, numbers - 1, 3)
    return sh


def encode_offsets(dx: np.ndarray, dq: np.ndarray, points: EncodedPoints, config: EncodeConfig) -> Sections:
    """Sections `dx` and `dq` of offsets dx [T, N, 3] and dq [T, N, 4] in the order of the input points.

    Rotations are stored about the world's axes, in which neighbours turn alike. Each section is decoded again, and its largest error,
    of a coordinate in world units or of a rotation in radians, is stored.
    """
    here = points.neighbourhood
    moves = np.asarray(dx, np.float64)[:, points.order].transpose(1, 0, 2)
    vectors = rotvec.of_quats(rotations.normalize(np.asarray(dq, np.float64))[:, points.order]).transpose(1, 0, 2)
    vectors = vectors @ rotations.to_matrix(rotations.normalize(points.quats.astype(np.float64))).transpose(0, 2, 1)
    sections: Sections = {}
    steps = {"dx": (moves, STEPS.motion * points.size), "dq": (vectors, STEPS.turn)}
    for name, (values, step) in steps.items():
        section, decoded = _encode_klt(MOTION, values, step * config.coarseness, here)
        error = float(np.abs(decoded - values.transpose(1, 0, 2)).max())
        sections[name] = Section(section.data, section.parameters | {"error": error})
    return sections


def decode_offsets(
    sections: Sections, frames: int, quats: np.ndarray, here: Neighbourhood
) -> tuple[np.ndarray, np.ndarray]:
    """dx [T, N, 3] and unit dq [T, N, 4], float32, of points turned by quats [N, 4]. Raises `ReelError`."""
    count = len(quats)
    dx = named("dx", _decode_klt, MOTION, section_of(sections, "dx", "klt"), frames, 3, here).expand(slice(0, count))
    found = named("dq", _decode_klt, MOTION, section_of(sections, "dq", "klt"), frames, 3, here)
    dq = np.empty((frames, count, 4), np.float32)
    for some in _blocks(count, frames):
        turns = rotations.to_matrix(quats[some].astype(np.float64))
        dq[:, some] = rotvec.expand(found.expand(some), turns)
    return dx, dq


def encode_shade(shade: np.ndarray, order: np.ndarray, here: Neighbourhood, config: EncodeConfig) -> Sections:
    """Section `shade` of changes of colour and opacity [T, N, 4], in the order of the input points."""
    values = np.asarray(shade, np.float64)[:, order].transpose(1, 0, 2) @ SHADE.T
    return {"shade": _encode_klt(COLOR, values, STEPS.shade * config.coarseness, here)[0]}


def decode_shade(sections: Sections, frames: int, here: Neighbourhood) -> np.ndarray:
    """[T, N, 4] float32. Raises `ReelError`."""
    count, back = len(here.classes), np.linalg.inv(SHADE).T.astype(np.float32)
    found = named("shade", _decode_klt, COLOR, section_of(sections, "shade", "klt"), frames, 4, here)
    shade = np.empty((frames, count, 4), np.float32)
    for some in _blocks(count, frames):
        shade[:, some] = found.expand(some) @ back
    return shade


def neighbours_in_order(count: int) -> Neighbourhood:
    """Of points in the paper's coding: those next to each other in the file, all of class 0."""
    lattice = np.zeros((count, 3), np.int64)
    lattice[:, 0] = np.arange(count)
    return Neighbourhood(levels_of(lattice), np.zeros((count, 3), np.int64))


def _encode_klt(kind: int, values: np.ndarray, step: float, here: Neighbourhood) -> tuple[Section, np.ndarray]:
    """Values [N, D, C]: D is what the transform is over, the C channels share its basis. Also gives them as decoded, [D, N, C]."""
    count, dimensions, channels = values.shape
    samples = values.transpose(0, 2, 1).reshape(-1, dimensions)
    basis, shifts = klt.analyse(samples, step)
    found = klt.coefficients(samples, basis, shifts).reshape(count, channels, -1).transpose(0, 2, 1) / step
    order, classes = klt.columns_of(found), here.classes[:, kind]
    wanted = found.reshape(count, -1)[:, order]
    ends = ends_of(wanted, classes)
    order = order[: max(int(ends.max()), 1)]
    kinds = int((order // channels).max()) + 1  # of the basis, what some point has
    basis, shifts, columns = basis[:, :kinds], shifts[:kinds], order % channels
    body, kept = encode_field(wanted[:, : len(order)], here.levels, classes, ends)
    streams = (
        klt.encode_basis(basis),
        encode(columns, np.zeros_like(columns), 1),
        encode_field(ends[:, None], here.levels, np.zeros_like(classes))[0],
        body,
    )
    data = _STREAMS.pack(*map(len, streams)) + b"".join(streams)
    section = Section(data, {"codec": "klt", "step": step, "shifts": shifts, "columns": len(columns)})
    return section, klt.expand(kept, ends, klt.real(basis, shifts) * step, columns, channels)


@dataclass(frozen=True)
class Coefficients:
    """A `klt` section before the transform back: found [N, L], of which points have the first ends [N]; see `klt.expand`."""

    found: np.ndarray
    ends: np.ndarray
    basis: np.ndarray
    columns: np.ndarray
    channels: int

    def expand(self, some: slice) -> np.ndarray:
        """Values [D, n, C] float32 of some of the points: a group's are large, and what is made of them is needed beside them."""
        return klt.expand(self.found[some], self.ends[some], self.basis, self.columns, self.channels)


def _blocks(count: int, dimensions: int) -> Iterator[slice]:
    size = max(_SOME // dimensions, 1)
    return (slice(first, min(first + size, count)) for first in range(0, count, size))


def _decode_klt(kind: int, section: Section, dimensions: int, channels: int, here: Neighbourhood) -> Coefficients:
    """What the section holds of values [D, N, C]. Raises `ReelError`."""
    data, parameters = section.data, section.parameters
    sizes = _STREAMS.unpack_from(data) if len(data) >= _STREAMS.size else (0,) * 4
    if _STREAMS.size + sum(sizes) != len(data):
        raise ReelError(f"holds {len(data)} bytes, its streams {', '.join(map(str, sizes))}.")
    cuts = np.cumsum([_STREAMS.size, *sizes]).tolist()
    basis_data, columns_data, ends_data, body = (data[a:b] for a, b in pairwise(cuts))
    step = number(parameters, "step", 1e-30, 1e30)
    basis = klt.decode_basis(basis_data, parameters, "shifts", dimensions)
    most = integer(parameters, "columns", 1, basis.shape[1] * channels)
    columns, classes = klt.decode_columns(columns_data, most, basis.shape[1], channels), here.classes[:, kind]
    ends = decode_field(ends_data, (len(classes), 1), here.levels, np.zeros_like(classes))[:, 0].astype(np.int64)
    if (ends < 0).any() or (ends > most).any():
        raise ReelError(f"has points of {ends.min()} to {ends.max()} columns, of {most}.")
    found = decode_field(body, (len(classes), most), here.levels, classes, ends)
    return Coefficients(found, ends, basis * step, columns, channels)
