"""One scale for image quality, used by `capture check`, the notes of a run, and the report."""

from __future__ import annotations

MARKS = "20 dB is poor, 30 dB is good, 40 dB is hardly distinguishable"
SCALE = f"PSNR measures how close images are to the camera's: {MARKS}."
FAIR, GOOD, EXCELLENT = 24.0, 28.0, 38.0
"""Smallest PSNR in dB of fair, good and very good images. Below the first they are poor."""


def rating(psnr: float) -> str:
    """Return the word for a PSNR in dB: very good, good, fair or poor."""
    for least, word in ((EXCELLENT, "very good"), (GOOD, "good"), (FAIR, "fair")):
        if psnr >= least:
            return word
    return "poor"
