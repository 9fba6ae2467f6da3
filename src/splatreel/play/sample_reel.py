"""The sample reel: the built-in scene, as the demo reconstructs it. `make sample` makes it again."""

from __future__ import annotations

from pathlib import Path

from splatreel.base.errors import ReelError

SAMPLE = Path(__file__).parent / "sample"
"""Folder of the sample reel in the package."""


def has_sample() -> bool:
    """Return whether the package contains the sample reel."""
    return (SAMPLE / "manifest.json").is_file()


def sample_reel() -> Path:
    """Return the folder of the sample reel.

    Raises:
        ReelError: The package does not contain it.
    """
    if not has_sample():
        raise ReelError(
            f"{SAMPLE}: this installation has no sample reel. `splatreel demo --out OUT` makes such a reel."
        )
    return SAMPLE
