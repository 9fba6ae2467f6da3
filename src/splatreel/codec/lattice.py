"""Positions on a lattice, as differences of Morton codes: the order of the points is where their bits are saved."""

from __future__ import annotations

import numpy as np

from splatreel.codec import morton
from splatreel.codec.entropy import Stream, encode
from splatreel.codec.quantize import Parameters, number, numbers
from splatreel.errors import ReelError

MAX_BITS = 17
"""Bits of an axis: a code then fits into a double, which is what a browser counts with."""


def encode_positions(means: np.ndarray, step: float) -> tuple[bytes, Parameters, np.ndarray, np.ndarray]:
    """Encode positions means [N, 3], N >= 1, to the nearest multiples of step, or of what 17 bits an axis allow.

    Returns the bytes, the parameters, order [N] (the input point that is decoded as point i), and the lattice [N, 3] int64.
    """
    means = np.asarray(means, np.float64)
    low = means.min(0)
    step = max(step, float((means.max(0) - low).max()) / ((1 << MAX_BITS) - 1), 1e-30)
    lattice = np.rint((means - low) / step).astype(np.int64)
    codes = morton.encode(lattice).astype(np.int64)
    order = np.argsort(codes, kind="stable")
    data = encode(np.diff(codes[order], prepend=0), np.zeros(len(order), np.int64), 1)
    return data, {"codec": "lattice", "min": low.tolist(), "step": step}, order, lattice[order]


def decode_positions(data: bytes, parameters: Parameters, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions [count, 3] float32 and their lattice [count, 3] int64. Raises `ReelError`."""
    low, step = numbers(parameters, "min", 3), number(parameters, "step", 0, 1e30)
    stream = Stream(data, 1)
    codes = np.cumsum(stream.read(count))
    stream.finish()
    if (codes < 0).any() or (codes >> 3 * MAX_BITS).any():
        raise ReelError("decodes to positions outside of its lattice.")
    lattice = morton.decode(codes)
    return (low + lattice * step).astype(np.float32), lattice
