"""Colors of the subject and of its surroundings in the images of a camera."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

BINS = 24
"""Number of bins of each axis: gray level, red minus green, blue minus the mean of red and green."""
CHROMA = 42.0
"""Largest difference of channels with bins of its own, gray levels."""
PRIOR = 2e-4
"""Share of pixels that is added to each bin."""
LIMIT = 2.0
"""Largest evidence of a color, as log odds."""


class ColorModel:
    """Histograms of the colors of the subject and of its surroundings, which grow by `add`.

    Args:
        counts: [2, BINS, BINS, BINS] float32, pixels of the subject and of its surroundings; by default none.
    """

    def __init__(self, counts: np.ndarray | None = None) -> None:
        self.counts = np.zeros((2, BINS, BINS, BINS), np.float32) if counts is None else counts

    @classmethod
    def merged(cls, models: Sequence[ColorModel]) -> ColorModel:
        """Return the colors in all of several cameras, which count alike."""
        totals = [np.maximum(model.counts.sum((1, 2, 3), keepdims=True), 1) for model in models]
        return cls(np.sum([model.counts / total for model, total in zip(models, totals, strict=True)], axis=0))

    def add(self, image: np.ndarray, subject: np.ndarray, surroundings: np.ndarray) -> None:
        """Count the pixels of an image [H, W, 3] uint8 that certainly show the subject or its surroundings, [H, W] bool each."""
        bins = _bins(image)
        for counts, pixels in zip(self.counts, (subject, surroundings), strict=True):
            counts += np.bincount(bins[pixels], minlength=BINS**3).reshape(counts.shape)

    def evidence(self, image: np.ndarray) -> np.ndarray:
        """Return log odds [H, W] float32 of the subject by the colors of an image [H, W, 3] uint8."""
        if not self.counts.any((1, 2, 3)).all():
            return np.zeros(image.shape[:2], np.float32)
        smooth = [_smoothed(counts / counts.sum()) for counts in self.counts]
        odds = np.log(smooth[0] + PRIOR) - np.log(smooth[1] + PRIOR)
        return np.clip(odds, -LIMIT, LIMIT).ravel()[_bins(image)]


def _bins(image: np.ndarray) -> np.ndarray:
    """Return the bin of each pixel, [H, W] int."""
    r, g, b = np.moveaxis(cv2.GaussianBlur(image, (0, 0), 0.8).astype(np.float32), -1, 0)
    axes = ((r + g + b) / 3 / 256, (r - g + CHROMA) / (2 * CHROMA), (b - (r + g) / 2 + CHROMA) / (2 * CHROMA))
    gray, first, second = (np.clip(axis * BINS, 0, BINS - 1).astype(np.int64) for axis in axes)
    return (gray * BINS + first) * BINS + second


def _smoothed(counts: np.ndarray) -> np.ndarray:
    """Return a histogram after a small blur along each axis."""
    for axis in range(3):
        padded = np.pad(counts, [(1, 1) if a == axis else (0, 0) for a in range(3)], mode="edge")
        parts = [np.take(padded, np.arange(k, k + BINS), axis) for k in range(3)]
        counts = 0.25 * parts[0] + 0.5 * parts[1] + 0.25 * parts[2]
    return counts
