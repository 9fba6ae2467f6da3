"""Morton (Z-order) codes, which keep spatial neighbors close in a list."""

from __future__ import annotations

import numpy as np

MAX_BITS = 21
"""Bits per axis that fit three times into a 64-bit code."""


def encode(q: np.ndarray) -> np.ndarray:
    """Return codes [N] uint64 of integer coordinates q [N, 3], 0 <= q < 2^21. Bit 3b + a of a code is bit b of axis a."""
    x, y, z = (_spread(q[:, axis].astype(np.uint64)) for axis in range(3))
    return x | (y << np.uint64(1)) | (z << np.uint64(2))


def decode(codes: np.ndarray) -> np.ndarray:
    """Return the integer coordinates [N, 3] int64 of codes [N]. This is the inverse of `encode`."""
    codes = codes.astype(np.uint64)
    return np.stack([_gather(codes >> np.uint64(axis)) for axis in range(3)], -1).astype(np.int64)


def neighbor_order(means: np.ndarray) -> np.ndarray:
    """Return the rows [N] of positions [N, 3] along a Morton curve through the ranks of their coordinates.

    Ranks instead of coordinates keep the curve fine where points are dense, whatever a few far points do.
    """
    ranks = np.empty(means.shape, np.int64)
    for axis in range(3):
        ranks[np.argsort(means[:, axis], kind="stable"), axis] = np.arange(len(means))
    return np.argsort(encode(ranks), kind="stable")


_STEPS = [
    (np.uint64(32), np.uint64(0x001F00000000FFFF)),
    (np.uint64(16), np.uint64(0x001F0000FF0000FF)),
    (np.uint64(8), np.uint64(0x100F00F00F00F00F)),
    (np.uint64(4), np.uint64(0x10C30C30C30C30C3)),
    (np.uint64(2), np.uint64(0x1249249249249249)),
]


def _spread(x: np.ndarray) -> np.ndarray:
    """Insert two zero bits before every bit."""
    for shift, mask in _STEPS:
        x = (x | (x << shift)) & mask
    return x


def _gather(x: np.ndarray) -> np.ndarray:
    """Keep every third bit."""
    x = x & _STEPS[-1][1]
    wider = [mask for _, mask in reversed(_STEPS[:-1])] + [np.uint64((1 << MAX_BITS) - 1)]
    for (shift, _), mask in zip(reversed(_STEPS), wider, strict=True):
        x = (x | (x >> shift)) & mask
    return x
