"""Offset codecs by name: how the deformation of the dynamic points over a group becomes bytes."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from splatreel.codec import h265
from splatreel.codec.quantize import Parameters
from splatreel.config import EncodeConfig
from splatreel.errors import ReelError

_CODECS = {"h265": h265}

MAX_FRAMES = 10_000
MAX_VALUES = 1 << 26
"""Frames times points that decode at most, so that a lying header cannot ask for all memory."""


def encode(dx: np.ndarray, dq: np.ndarray, config: EncodeConfig) -> tuple[bytes, Parameters]:
    """Encode dx [T, N, 3] and dq [T, N, 4], N >= 1, by the codec `config` names.

    Raises `ReelError` for an unknown codec, for NaN and for more offsets than one group may have.
    """
    check(dx, dq)
    return _codec(config.codec).encode(dx, dq, config)


def decode(data: bytes, parameters: Parameters, frames: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """dx [frames, count, 3] and unit dq [frames, count, 4], float32. Raises `ReelError` if data is damaged."""
    check_size(frames, count)
    return _codec(parameters.get("codec")).decode(data, parameters, frames, count)


def check(dx: np.ndarray, dq: np.ndarray) -> None:
    """Raise `ReelError` for offsets that cannot be encoded."""
    if not (np.isfinite(dx).all() and np.isfinite(dq).all()):
        raise ReelError("Offsets hold NaN or infinity and cannot be encoded.")
    if dx.shape[0] * dx.shape[1] > MAX_VALUES:
        raise ReelError(f"{dx.shape[1]} points x {dx.shape[0]} frames are too many offsets. Make shorter groups.")


def check_size(frames: int, count: int) -> None:
    """Raise `ReelError` where a file claims more offsets than are decoded."""
    if not 1 <= frames <= MAX_FRAMES or frames * count > MAX_VALUES:
        raise ReelError(f"claims {frames} frames of {count} points, more than can be decoded.")


def _codec(name: object) -> ModuleType:
    if not isinstance(name, str) or name not in _CODECS:
        raise ReelError(f"has the unknown offset codec {name!r}; known are {', '.join(sorted(_CODECS))}.")
    return _CODECS[name]
