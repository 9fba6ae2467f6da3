"""Orientation that a file declares for its images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

EXACT = 0.01
"""Maximum deviation of a display matrix from quarter turns."""


@dataclass(frozen=True)
class Orientation:
    """Mirroring and rotation that turn a stored image upright.

    Attributes:
        turns: Counterclockwise quarter turns.
        mirrored: True flips the stored image left to right before the rotation.
    """

    turns: int = 0
    mirrored: bool = False

    def apply(self, image: np.ndarray) -> np.ndarray:
        """Return a stored image [H, W, ...] upright."""
        return np.rot90(image[:, ::-1] if self.mirrored else image, self.turns)

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Return width and height after a change between stored and upright, in either direction."""
        return (height, width) if self.turns % 2 else (width, height)


STORED = Orientation()
"""Orientation of files that declare none."""
ALL = [Orientation(turns, mirrored) for mirrored in (False, True) for turns in range(4)]
EXIF = dict(enumerate((ALL[0], ALL[4], ALL[2], ALL[6], ALL[5], ALL[3], ALL[7], ALL[1]), start=1))
"""Orientations by their number in EXIF."""


def display_orientation(matrix: bytes) -> Orientation | None:
    """Return the orientation of FFmpeg's display matrix, or None if it is not a quarter turn.

    Args:
        matrix: Nine 32-bit integers. The first two of each row are a linear map of row vectors.
    """
    linear = np.frombuffer(matrix, np.int32, 9).reshape(3, 3)[:2, :2].T.astype(np.float64)
    lengths = np.linalg.norm(linear, axis=0)
    if not lengths.all():
        return None
    quarter = np.array([[0, 1], [-1, 0]])  # right becomes up, down becomes right
    for orientation in ALL:
        flip = np.diag([-1 if orientation.mirrored else 1, 1])
        if np.abs(linear / lengths - np.linalg.matrix_power(quarter, orientation.turns) @ flip).max() <= EXACT:
            return orientation
    return None
