"""Missing frames of cameras: time steps that are used, the frames that stand in, and their description."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

OUT_OF_STEP = 0.6
"""Maximum difference between a time step and a frame that shows it, in frames. Beyond, the frame is missing."""
MOST_NAMED = 4
"""Maximum number of cameras and of stretches of frames that a sentence lists."""


def used_steps(exists: Mapping[str, np.ndarray]) -> tuple[int, int]:
    """Return the first and the end of the time steps to use: from the first to the last that most cameras have.

    A camera that lacks frames costs the others none of theirs. Steps beyond, with few cameras, cannot be reconstructed.

    Args:
        exists: By camera [steps] bool, whether the camera has a frame.
    """
    if not exists:
        return 0, 0
    counts = np.stack(list(exists.values())).sum(0)
    most = np.flatnonzero(2 * counts > len(exists))
    return (int(most[0]), int(most[-1]) + 1) if len(most) else (0, 0)


def nearest(exists: np.ndarray) -> np.ndarray:
    """Return for each step the nearest one with a frame, [steps] int64; the earlier of two. At least one must have a frame."""
    there = np.flatnonzero(exists)
    return there[np.searchsorted((there[1:] + there[:-1]) / 2, np.arange(len(exists)))]


def describe_gaps(missing: Mapping[str, np.ndarray], labels: Sequence[int], noun: str) -> list[str]:
    """Return a sentence about the frames that cameras lack, or nothing.

    Args:
        missing: By camera [steps] bool.
        labels: Numbers of the steps, as users know them.
        noun: Noun for the frames, in the plural.
    """
    gaps = {name: np.flatnonzero(mask) for name, mask in missing.items() if mask.any()}
    if not gaps:
        return []
    named = [f"{name} has no {noun} {_stretches(steps, labels)}" for name, steps in list(gaps.items())[:MOST_NAMED]]
    more = f"; {len(gaps) - MOST_NAMED} more cameras have gaps" if len(gaps) > MOST_NAMED else ""
    return [f"{'; '.join(named)}{more}: left out of training for that camera only"]


def _stretches(steps: np.ndarray, labels: Sequence[int]) -> str:
    """Return `5, 7-9` for steps, with the count of further ones."""
    runs = np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1)
    texts = [f"{labels[run[0]]}-{labels[run[-1]]}" if len(run) > 1 else f"{labels[run[0]]}" for run in runs]
    rest = sum(len(run) for run in runs[MOST_NAMED:])
    return ", ".join(texts[:MOST_NAMED]) + (f" and {rest} more" if rest else "")
