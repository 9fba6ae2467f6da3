"""The Karhunen-Loeve transform: samples as few numbers in a basis of their own, which is sent along (docs/format.md)."""

from __future__ import annotations

import numpy as np

from splatreel.codec.entropy import Decoder, Encoder, unzigzag, zigzag
from splatreel.codec.quantize import Parameters, integer
from splatreel.errors import ReelError

_MAX_SHIFT = 20
_SPARE = 8
"""Rounding the basis costs at most about this fraction of a step."""


def analyse(samples: np.ndarray, step: float) -> tuple[np.ndarray, list[int]]:
    """The basis [D, K] int64 of samples [M, D] and shifts [K]: column k in units of 2^-shifts[k].

    Directions in which the samples spread by less than a twentieth of a step are left out; K is at least 1.
    """
    spread, basis = np.linalg.eigh(samples.T @ samples / max(len(samples), 1))
    spread, basis = np.sqrt(np.maximum(spread[::-1], 0)), basis[:, ::-1]
    count = max(int((spread > step / 20).sum()), 1)
    shifts = np.clip(np.ceil(np.log2(np.maximum(spread[:count] * _SPARE / step, 1))), 4, _MAX_SHIFT).astype(np.int64)
    return np.rint(basis[:, :count] * 2.0**shifts).astype(np.int64), shifts.tolist()


def coefficients(samples: np.ndarray, basis: np.ndarray, shifts: list[int]) -> np.ndarray:
    """What samples [M, D] are in the rounded basis, [M, K]."""
    return samples @ np.linalg.pinv(real(basis, shifts)).T


def real(basis: np.ndarray, shifts: list[int]) -> np.ndarray:
    return basis * 2.0 ** -np.array(shifts)


def encode_basis(basis: np.ndarray) -> bytes:
    """Column after column."""
    encoder = Encoder(1)
    encoder.write(zigzag(basis.T.ravel()), 0)
    return encoder.finish()


def decode_basis(data: bytes, parameters: Parameters, name: str, dimensions: int) -> np.ndarray:
    """The basis [dimensions, K] float64 whose shifts are the parameter `name`. Raises `ReelError`."""
    shifts = parameters.get(name)
    if not isinstance(shifts, list) or not 1 <= len(shifts) <= dimensions:
        raise ReelError(f"has {name} that are not 1 to {dimensions} numbers.")
    shifts = [integer({name: shift}, name, 0, _MAX_SHIFT) for shift in shifts]
    decoder = Decoder(data, 1)
    basis = unzigzag(decoder.read(np.zeros(len(shifts) * dimensions, np.int64)))
    decoder.finish()
    return real(basis.reshape(len(shifts), dimensions).T, shifts)
