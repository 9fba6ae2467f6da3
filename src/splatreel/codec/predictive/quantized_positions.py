"""Positions on a lattice, as differences of Morton codes: the order of the points is where their bits are saved.

Where in its cell of the lattice a point lies is told apart: those that show finely get more bits for it.
"""

from __future__ import annotations

import numpy as np

from splatreel.codec import morton
from splatreel.codec.predictive.entropy import Stream, encode
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


def decode_positions(data: bytes, parameters: Parameters, count: int) -> np.ndarray:
    """The lattice [count, 3] int64. Raises `ReelError`."""
    _cells(parameters)
    stream = Stream(data, 1)
    codes = np.cumsum(stream.read(count))
    stream.finish()
    if (codes < 0).any() or (codes >> 3 * MAX_BITS).any():
        raise ReelError("decodes to positions outside of its lattice.")
    return morton.decode(codes)


def encode_places(means: np.ndarray, parameters: Parameters, lattice: np.ndarray, bits: np.ndarray) -> bytes:
    """Which of 2^bits [N] parts along each axis of its cell in the lattice [N, 3] every point of means [N, 3] lies in."""
    within = (np.asarray(means, np.float64) - parameters["min"]) / parameters["step"] - lattice + 0.5
    parts = 1 << bits[:, None]
    places = np.clip(np.floor(within * parts), 0, parts - 1).astype(np.int64)
    planes = [(places[bits > b] >> b & 1).ravel() for b in range(int(bits.max(initial=0)))]
    return np.packbits(np.concatenate([np.zeros(0, np.int64), *planes]).astype(bool), bitorder="little").tobytes()


def decode_places(data: bytes, parameters: Parameters, lattice: np.ndarray, bits: np.ndarray) -> np.ndarray:
    """Positions [N, 3] float32, in the middle of their parts. Raises `ReelError`."""
    low, step = _cells(parameters)
    if len(data) != (3 * int(bits.sum()) + 7) // 8:
        raise ReelError(f"holds {len(data)} bytes where its points have {3 * int(bits.sum())} bits.")
    plain, used = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little"), 0
    places = np.zeros(lattice.shape, np.int64)
    for b in range(int(bits.max(initial=0))):
        finer = bits > b
        count = 3 * int(finer.sum())
        places[finer] |= plain[used : used + count].reshape(-1, 3).astype(np.int64) << b
        used += count
    parts = 1 << bits[:, None]
    return (low + (lattice + (2 * places + 1 - parts) / (2 * parts)) * step).astype(np.float32)


def _cells(parameters: Parameters) -> tuple[np.ndarray, float]:
    """Where the lattice begins, and how wide its cells are. Raises `ReelError`."""
    return numbers(parameters, "min", 3), number(parameters, "step", 0, 1e30)
