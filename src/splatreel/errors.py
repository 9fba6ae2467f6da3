"""Errors that Splatreel raises on purpose, for programs that use it. `base/errors.py` defines them."""

from splatreel.base.errors import (
    CancelledError,
    CaptureError,
    GaussiansError,
    InUseError,
    MissingDependencyError,
    ReconstructionError,
    ReelError,
    SplatreelError,
    StorageError,
    UsageError,
)

__all__ = [
    "CancelledError",
    "CaptureError",
    "GaussiansError",
    "InUseError",
    "MissingDependencyError",
    "ReconstructionError",
    "ReelError",
    "SplatreelError",
    "StorageError",
    "UsageError",
]
