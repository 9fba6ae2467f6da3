"""Karhunen-Loeve transform: samples as few coefficients in a basis that is stored with them (docs/format.md)."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit

from splatreel.base.errors import ReelError
from splatreel.base.jit import EXACT
from splatreel.codec.container import Section
from splatreel.codec.predictive.entropy import Stream, entropy_encode, unzigzag, zigzag
from splatreel.codec.predictive.lod_prediction import Predictor, decode_lod, encode_lod, ends_of
from splatreel.codec.predictive.precision import Basis
from splatreel.codec.quantize import Parameters, integer, number

_MAX_SHIFT = 20
_MOST_NUMBERS = 1 << 20
"""Maximum size of a basis. A basis of zeros takes no bytes, however large it claims to be."""
_BLOCK = 32
"""Points whose sums stay in the cache before they are written frame by frame."""
_SPARE = 8
"""Inverse of the rounding error of the basis, in steps."""


def analyze(samples: np.ndarray, step: float) -> tuple[np.ndarray, list[int]]:
    """Return the basis [D, K] int64 of samples [M, D] and shifts [K]; column k has units of 2^-shifts[k].

    Directions with a spread below a twentieth of a step are dropped. K is at least 1, and K D at most `_MOST_NUMBERS`.
    """
    spread, basis = np.linalg.eigh(_products(np.ascontiguousarray(samples)) / max(len(samples), 1))
    spread, basis = np.sqrt(np.maximum(spread[::-1], 0)), basis[:, ::-1]
    count = min(max(int((spread > step / 20).sum()), 1), _MOST_NUMBERS // len(spread))
    shifts = np.clip(np.ceil(np.log2(np.maximum(spread[:count] * _SPARE / step, 1))), 4, _MAX_SHIFT).astype(np.int64)
    return np.rint(basis[:, :count] * 2.0**shifts).astype(np.int64), shifts.tolist()


def coefficients(samples: np.ndarray, basis: np.ndarray, shifts: Sequence[int]) -> np.ndarray:
    """Return the coefficients [M, K] of samples [M, D] in the rounded basis."""
    inverse = np.ascontiguousarray(np.linalg.pinv(real(basis, shifts)).T)
    return _multiply(np.ascontiguousarray(samples), inverse)


@njit(**EXACT)
def _products(samples):
    """Return samples.T @ samples [D, D]. In NumPy's product of so narrow a matrix, BLAS's threads mostly wait for each other."""
    count, dimensions = samples.shape
    sums = np.zeros((dimensions, dimensions))
    for m in range(count):
        row = samples[m]
        for i in range(dimensions):
            value, total = row[i], sums[i]
            for j in range(i, dimensions):
                total[j] += value * row[j]
    for i in range(dimensions):
        for j in range(i):
            sums[i, j] = sums[j, i]
    return sums


@njit(**EXACT)
def _multiply(samples, matrix):
    """Return samples [M, D] @ matrix [D, K], see `_products`."""
    count, dimensions = samples.shape
    result = np.zeros((count, matrix.shape[1]))
    for m in range(count):
        total = result[m]
        for d in range(dimensions):
            value, row = samples[m, d], matrix[d]
            for k in range(len(row)):
                total[k] += value * row[k]
    return result


def real(basis: np.ndarray, shifts: Sequence[int]) -> np.ndarray:
    """Return the basis as float64."""
    return basis * 2.0 ** -np.array(shifts)


def columns_of(found: np.ndarray) -> np.ndarray:
    """Return the order [K C] of coefficients [N, K, C], as k C + c: large ones first, and those of a channel in the order of the basis.

    Columns that are small for all points come last, where few points store them.
    """
    sizes = np.abs(found).mean(0)
    falling = np.maximum.accumulate(sizes[::-1])[::-1]
    return np.argsort(-falling.ravel(), kind="stable")


def decode_columns(data: bytes, count: int, kinds: int, channels: int) -> np.ndarray:
    """Decode the channel of each of `count` columns. Raise `ReelError` if a channel has more than `kinds` columns."""
    stream = Stream(data, 1)
    columns = stream.read(count)
    stream.finish()
    if (columns < 0).any() or (columns >= channels).any() or np.bincount(columns, minlength=1).max() > kinds:
        raise ReelError(f"has columns that are not those of {channels} channels of {kinds} each.")
    return columns


def encode_basis(basis: np.ndarray) -> bytes:
    """Encode a basis column by column."""
    return entropy_encode(zigzag(basis.T.ravel()), np.zeros(basis.size, np.int64), 1)


def decode_basis(data: bytes, parameters: Parameters, name: str, dimensions: int) -> np.ndarray:
    """Decode the basis [dimensions, K] float64 whose shifts are the parameter `name`. Raise `ReelError` if it is damaged."""
    shifts = parameters.get(name)
    if not isinstance(shifts, list) or not 1 <= len(shifts) <= dimensions:
        raise ReelError(f"has {name} that are not 1 to {dimensions} numbers.")
    if len(shifts) * dimensions > _MOST_NUMBERS:
        raise ReelError(f"has {name} for a basis of {len(shifts)} x {dimensions} numbers, more than {_MOST_NUMBERS}.")
    shifts = [integer({name: shift}, name, 0, _MAX_SHIFT) for shift in shifts]
    stream = Stream(data, 1)
    basis = unzigzag(stream.read(len(shifts) * dimensions))
    stream.finish()
    return real(basis.reshape(len(shifts), dimensions).T, shifts)


def expand(found: np.ndarray, ends: np.ndarray, basis: np.ndarray, columns: np.ndarray, channels: int) -> np.ndarray:
    """Return values [D, N, C] float32 of coefficients.

    Args:
        found: Coefficients, [N, L].
        ends: Number of coefficients that each point has, [N].
        basis: Basis, [D, K].
        columns: Channel of each column, [L]. The n-th column of a channel belongs to the n-th vector of the basis.
        channels: Number of channels C.
    """
    result = np.empty((len(basis), len(found), channels), np.float32)
    vectors = _vectors_of(columns)
    _expand(found, ends, np.ascontiguousarray(basis.T), columns.astype(np.int64), vectors, result)
    return result


def _vectors_of(columns: np.ndarray) -> np.ndarray:
    """Return the vector of the basis that each column belongs to, [L] int64, by the channels [L] of the columns."""
    return np.array([(columns[:place] == channel).sum() for place, channel in enumerate(columns)], np.int64)


@njit(**EXACT)
def _expand(found, ends, basis, columns, vectors, result):
    dimensions, count, channels = result.shape
    sums = np.empty((_BLOCK, channels, dimensions))
    for first in range(0, count, _BLOCK):
        some = min(_BLOCK, count - first)
        sums[:] = 0
        for i in range(some):
            for column in range(ends[first + i]):
                value = np.float64(found[first + i, column])
                if value != 0:
                    row, total = basis[vectors[column]], sums[i, columns[column]]
                    for d in range(dimensions):
                        total[d] += value * row[d]
        for d in range(dimensions):
            for i in range(some):
                for c in range(channels):
                    result[d, first + i, c] = sums[i, c, d]


_STREAMS = struct.Struct("<IIII")
"""Lengths of the four streams: basis, channels of the columns, numbers of columns, coefficients."""
_BLOCK_VALUES = 1 << 18
"""Values processed at a time."""


def encode_klt(
    kind: int, values: np.ndarray, step: float, predictor: Predictor, known: Basis | None = None
) -> tuple[Section, np.ndarray]:
    """Encode values [N, D, C]. The transform is over D, and the C channels share its basis.

    Args:
        kind: Kind of the points' classes.
        values: Values to encode.
        step: Quantization step.
        predictor: Predictor of the points.
        known: Basis of the section from which the values were decoded; None finds a basis.

    Returns:
        The section, and the values as decoded, [D, N, C].
    """
    count, dimensions, channels = values.shape
    samples = values.transpose(0, 2, 1).reshape(-1, dimensions)
    basis, shifts = analyze(samples, step) if known is None else (known.vectors, known.shifts)
    found = coefficients(samples, basis, shifts).reshape(count, channels, -1).transpose(0, 2, 1) / step
    order, classes = columns_of(found), predictor.classes[:, kind]
    if known is not None and known.columns is not None:
        order = _vectors_of(known.columns) * channels + known.columns
    wanted = found.reshape(count, -1)[:, order]
    ends = ends_of(wanted, classes) if known is None or known.ends is None else known.ends
    order = order[: max(int(ends.max()), 1)]
    kinds = int((order // channels).max()) + 1  # vectors of the basis that some point uses
    basis, shifts, columns = basis[:, :kinds], list(shifts[:kinds]), order % channels
    body, kept = encode_lod(wanted[:, : len(order)], predictor.levels, classes, ends)
    streams = (
        encode_basis(basis),
        entropy_encode(columns, np.zeros_like(columns), 1),
        encode_lod(ends[:, None], predictor.levels, np.zeros_like(classes))[0],
        body,
    )
    data = _STREAMS.pack(*map(len, streams)) + b"".join(streams)
    section = Section(data, {"codec": "klt", "step": step, "shifts": shifts, "columns": len(columns)})
    return section, expand(kept, ends, real(basis, shifts) * step, columns, channels)


@dataclass(frozen=True)
class Coefficients:
    """Decoded `klt` section before the inverse transform; see `klt.expand`.

    Attributes:
        found: Coefficients, [N, L].
        ends: Number of coefficients that each point has, [N].
        basis: Basis, [D, K].
        columns: Channel of each column, [L].
        channels: Number of channels C.
    """

    found: np.ndarray
    ends: np.ndarray
    basis: np.ndarray
    columns: np.ndarray
    channels: int

    def expand(self, some: slice) -> np.ndarray:
        """Return the values [D, n, C] float32 of a slice of the points, which limits the memory for large groups."""
        return expand(self.found[some], self.ends[some], self.basis, self.columns, self.channels)


def read_basis(kind: int, section: Section, dimensions: int, channels: int, predictor: Predictor) -> Basis:
    """Return the basis of a `klt` section. Arguments and errors are those of `decode_klt`."""
    found, shifts = decode_klt(kind, section, dimensions, channels, predictor), section.parameters["shifts"]
    vectors = np.rint(found.basis / section.parameters["step"] * 2.0 ** np.array(shifts)).astype(np.int64)
    return Basis(vectors, tuple(shifts), found.columns, found.ends)


def decode_klt(kind: int, section: Section, dimensions: int, channels: int, predictor: Predictor) -> Coefficients:
    """Decode the coefficients of values [D, N, C]. Raise `ReelError` if the section is damaged."""
    data, parameters = section.data, section.parameters
    sizes = _STREAMS.unpack_from(data) if len(data) >= _STREAMS.size else (0,) * 4
    if _STREAMS.size + sum(sizes) != len(data):
        raise ReelError(f"holds {len(data)} bytes, its streams {', '.join(map(str, sizes))}.")
    cuts = np.cumsum([_STREAMS.size, *sizes]).tolist()
    basis_data, columns_data, ends_data, body = (data[a:b] for a, b in pairwise(cuts))
    step = number(parameters, "step", 1e-30, 1e30)
    basis = decode_basis(basis_data, parameters, "shifts", dimensions)
    most = integer(parameters, "columns", 1, basis.shape[1] * channels)
    columns, classes = decode_columns(columns_data, most, basis.shape[1], channels), predictor.classes[:, kind]
    ends = decode_lod(ends_data, (len(classes), 1), predictor.levels, np.zeros_like(classes))[:, 0].astype(np.int64)
    if (ends < 0).any() or (ends > most).any():
        raise ReelError(f"has points of {ends.min()} to {ends.max()} columns, of {most}.")
    found = decode_lod(body, (len(classes), most), predictor.levels, classes, ends)
    return Coefficients(found, ends, basis * step, columns, channels)


def blocks(count: int, dimensions: int) -> Iterator[slice]:
    """Return slices of points for processing `dimensions` values per point."""
    size = max(_BLOCK_VALUES // dimensions, 1)
    return (slice(first, min(first + size, count)) for first in range(0, count, size))
