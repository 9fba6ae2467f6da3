"""One scale for picture quality, shared by `capture check`, a run's notes and the report."""

from __future__ import annotations

MARKS = "20 dB is poor, 30 dB good, 40 dB hardly to be told apart"
SCALE = f"PSNR tells how close pictures are to the camera's: {MARKS}."
FAIR, GOOD, EXCELLENT = 24.0, 28.0, 38.0
"""dB from which on pictures are fair, good and very good; below the first they are poor."""


def rating(psnr: float) -> str:
    """Return the word for a PSNR in dB."""
    for least, word in ((EXCELLENT, "very good"), (GOOD, "good"), (FAIR, "fair")):
        if psnr >= least:
            return word
    return "poor"
