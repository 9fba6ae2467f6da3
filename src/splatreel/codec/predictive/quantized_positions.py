"""Quantized positions as differences of Morton codes, which are small because the points are sorted by them.

Refinement bits give the position of a point within its grid cell. Important points have more of them.
"""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.codec.predictive.entropy import Stream, entropy_encode
from splatreel.codec.quantize import Parameters, number, numbers
from splatreel.scene import morton

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
