"""Memory limit of decoding an untrusted file, in proportion to its length.

Repeated numbers compress to almost nothing, so a small file can claim very many points. The limit is checked against the
file's own claims before anything is allocated.
"""

from __future__ import annotations

from dataclasses import dataclass

from splatreel.base.errors import GaussiansError

FLOOR = 32 << 20
"""Bytes of memory that any file may take."""
A_BYTE = 256
"""Additional bytes of memory allowed per byte of file length."""
_POINT, _COEFFICIENT = 400, 32
"""Bytes of memory that importing a point takes without view-dependent color, and per number of view-dependent color."""


def allowed_memory(size: int) -> int:
    """Return the bytes of memory that decoding a file of `size` bytes may take."""
    return FLOOR + A_BYTE * size


def in_megabytes(count: int) -> int:
    """Return bytes as megabytes, rounded up."""
    return -(-count // 1_000_000)


def points_memory(count: int, coefficients: int = 0) -> int:
    """Return the bytes of memory that importing points takes.

    Args:
        count: Number of points.
        coefficients: Numbers of view-dependent color per point, all channels together.
    """
    return count * (_POINT + _COEFFICIENT * coefficients)


@dataclass(frozen=True)
class MemoryBudget:
    """Memory that importing one file may take.

    Attributes:
        most: Limit in bytes for any file; None limits each file in proportion to its length.
        length: Length that counts instead of the file's own, such as that of a packed member of an archive.
    """

    most: int | None = None
    length: int | None = None

    def limit(self, size: int) -> int:
        """Return the bytes of memory that a file of `size` bytes may take."""
        return allowed_memory(size if self.length is None else self.length) if self.most is None else self.most

    def check(self, needed: int, size: int, source: str, claim: str) -> None:
        """Raise `GaussiansError` if reading a file takes too much memory.

        Args:
            needed: Memory that reading takes, bytes.
            size: Length of the file in bytes.
            source: Name of the file.
            claim: Content that takes the memory, such as "5,000 points".
        """
        limit = self.limit(size)
        if needed > limit:
            length = size if self.length is None else self.length
            raise GaussiansError(
                f"{source}: claims {claim} in {length:,} bytes. Reading it would take {in_megabytes(needed):,} MB of memory, more than "
                f"the {in_megabytes(limit):,} MB that are allowed. If you trust it, allow more: --max-memory {in_megabytes(needed)}."
            )


UNRAISED = MemoryBudget()
"""Limit in proportion to the length of each file."""
