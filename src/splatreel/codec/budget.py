"""Memory that decoding a reel's file takes, computed from its header and limited before any allocation (docs/format.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.base.memory_budget import A_BYTE, FLOOR, allowed_memory, in_megabytes
from splatreel.codec.quantize import is_whole

MOST_FRAMES = 10_000
"""Maximum number of frames of a group."""
MAX_OFFSETS = 1 << 26
"""Maximum number of frames times points of a group."""
_POINT, _VALUE, _COEFFICIENT, _COLOR, _BASIS, _PIXEL = 256, 32, 6, 6, 32, 2
"""Bytes of memory per point, per point and frame, per `klt` coefficient, per `sh_rest` number, per basis number and per map pixel."""


class Coded(Protocol):
    """Section described by its parameters."""

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the section."""
        ...


def claimed_memory(points: int, frames: int, sections: Mapping[str, Coded]) -> int:
    """Return the bytes of memory that decoding a file takes.

    Args:
        points: Points of the file.
        frames: Frames of the group; 0 for a layer.
        sections: Sections by name. Invalid parameters count as 0; the decoders refuse them later.
    """
    found = {name: section.parameters for name, section in sections.items()}
    a_point = _POINT + _VALUE * frames * (2 if "shade" in found else 1)
    a_point += _COEFFICIENT * max((_whole(p, "columns") for p in found.values() if p.get("codec") == "klt"), default=0)
    basis = max((len(p["shifts"]) for p in found.values() if isinstance(p.get("shifts"), list)), default=0)
    degree = min(_whole(found.get("sh_rest", {}), "degree"), 3)
    a_point += _COLOR * 3 * ((degree + 1) ** 2 - 1)
    images = sum(_area(p) * (10 * frames if name == "offsets" else 3) for name, p in found.items())
    images += _area(found.get("sh_rest", {})) * 3 * (degree + 1) ** 2
    flags = _whole(found.get("alive", {}), "count")
    return points * a_point + _BASIS * basis * max(frames, 45) + _PIXEL * images + 2 * flags


def check_memory(points: int, frames: int, sections: Mapping[str, Coded], size: int, most: int | None = None) -> None:
    """Raise `ReelError` if decoding a file takes too much memory.

    Args:
        points: Points of the file.
        frames: Frames of the group; 0 for a layer.
        sections: Sections by name.
        size: Length of the file in bytes.
        most: Memory limit in bytes; None uses `allowed_memory(size)`.
    """
    limit, needed = allowed_memory(size) if most is None else most, claimed_memory(points, frames, sections)
    if needed > limit:
        what = f"{frames} frames of {points}" if frames else f"{points}"
        raise ReelError(
            f"claims {what} points in {size} bytes: decoding it would take {in_megabytes(needed)} MB of memory, more than the "
            f"{in_megabytes(limit)} MB that are allowed. If you trust it, allow more: `most`, or --max-memory {in_megabytes(needed)}."
        )


def missing_bytes(points: int, frames: int, sections: Mapping[str, Coded], size: int) -> int:
    """Return how many bytes of padding a file of `size` bytes needs for its memory to be allowed. Usually 0."""
    return max(-(-(claimed_memory(points, frames, sections) - allowed_memory(size)) // A_BYTE), 0)


def most_points(size: int) -> int:
    """Return the maximum number of points in files of `size` bytes together."""
    return size + FLOOR // A_BYTE


def _whole(parameters: Mapping[str, Any], name: str) -> int:
    value = parameters.get(name)
    return int(value) if is_whole(value) and 0 <= value <= 1 << 26 else 0


def _area(parameters: Mapping[str, Any]) -> int:
    return _whole(parameters, "width") * _whole(parameters, "height")


def check_offsets(dx: np.ndarray, dq: np.ndarray) -> None:
    """Raise `ReelError` if offsets dx [T, N, 3] or dq [T, N, 4] are not finite or too many for a group."""
    if not (np.isfinite(dx).all() and np.isfinite(dq).all()):
        raise ReelError("Offsets hold NaN or infinity and cannot be encoded.")
    if dx.shape[0] * dx.shape[1] > MAX_OFFSETS:
        raise ReelError(f"{dx.shape[1]} points x {dx.shape[0]} frames are too many offsets. Make shorter groups.")


def check_offset_count(frames: int, points: int) -> None:
    """Raise `ReelError` if a file claims more offsets than a group may have."""
    if not 1 <= frames <= MOST_FRAMES or frames * points > MAX_OFFSETS:
        raise ReelError(f"claims {frames} frames of {points} points, more than can be decoded.")
