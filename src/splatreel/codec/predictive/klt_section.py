"""Sections of the codec `klt`: values per point as few coefficients in a basis that is stored with them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from splatreel.codec.predictive import klt
from splatreel.codec.predictive.entropy import entropy_encode
from splatreel.codec.predictive.lod_prediction import decode_lod, encode_lod, ends_of
from splatreel.codec.predictive.predictor import Predictor
from splatreel.codec.quantize import integer, number
from splatreel.codec.section import Section
from splatreel.errors import ReelError

_STREAMS = struct.Struct("<IIII")
"""Lengths of the four streams: basis, channels of the columns, numbers of columns, coefficients."""
_BLOCK_VALUES = 1 << 18
"""Values processed at a time."""


def encode_klt(kind: int, values: np.ndarray, step: float, predictor: Predictor) -> tuple[Section, np.ndarray]:
    """Encode values [N, D, C]. The transform is over D, and the C channels share its basis.

    Returns:
        The section, and the values as decoded, [D, N, C].
    """
    count, dimensions, channels = values.shape
    samples = values.transpose(0, 2, 1).reshape(-1, dimensions)
    basis, shifts = klt.analyze(samples, step)
    found = klt.coefficients(samples, basis, shifts).reshape(count, channels, -1).transpose(0, 2, 1) / step
    order, classes = klt.columns_of(found), predictor.classes[:, kind]
    wanted = found.reshape(count, -1)[:, order]
    ends = ends_of(wanted, classes)
    order = order[: max(int(ends.max()), 1)]
    kinds = int((order // channels).max()) + 1  # vectors of the basis that some point uses
    basis, shifts, columns = basis[:, :kinds], shifts[:kinds], order % channels
    body, kept = encode_lod(wanted[:, : len(order)], predictor.levels, classes, ends)
    streams = (
        klt.encode_basis(basis),
        entropy_encode(columns, np.zeros_like(columns), 1),
        encode_lod(ends[:, None], predictor.levels, np.zeros_like(classes))[0],
        body,
    )
    data = _STREAMS.pack(*map(len, streams)) + b"".join(streams)
    section = Section(data, {"codec": "klt", "step": step, "shifts": shifts, "columns": len(columns)})
    return section, klt.expand(kept, ends, klt.real(basis, shifts) * step, columns, channels)


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
        return klt.expand(self.found[some], self.ends[some], self.basis, self.columns, self.channels)


def decode_klt(kind: int, section: Section, dimensions: int, channels: int, predictor: Predictor) -> Coefficients:
    """Decode the coefficients of values [D, N, C]. Raise `ReelError` if the section is damaged."""
    data, parameters = section.data, section.parameters
    sizes = _STREAMS.unpack_from(data) if len(data) >= _STREAMS.size else (0,) * 4
    if _STREAMS.size + sum(sizes) != len(data):
        raise ReelError(f"holds {len(data)} bytes, its streams {', '.join(map(str, sizes))}.")
    cuts = np.cumsum([_STREAMS.size, *sizes]).tolist()
    basis_data, columns_data, ends_data, body = (data[a:b] for a, b in pairwise(cuts))
    step = number(parameters, "step", 1e-30, 1e30)
    basis = klt.decode_basis(basis_data, parameters, "shifts", dimensions)
    most = integer(parameters, "columns", 1, basis.shape[1] * channels)
    columns, classes = klt.decode_columns(columns_data, most, basis.shape[1], channels), predictor.classes[:, kind]
    ends = decode_lod(ends_data, (len(classes), 1), predictor.levels, np.zeros_like(classes))[:, 0].astype(np.int64)
    if (ends < 0).any() or (ends > most).any():
        raise ReelError(f"has points of {ends.min()} to {ends.max()} columns, of {most}.")
    found = decode_lod(body, (len(classes), most), predictor.levels, classes, ends)
    return Coefficients(found, ends, basis * step, columns, channels)


def blocks(count: int, dimensions: int) -> Iterator[slice]:
    """Return slices of points for processing `dimensions` values per point."""
    size = max(_BLOCK_VALUES // dimensions, 1)
    return (slice(first, min(first + size, count)) for first in range(0, count, size))
