"""What the built-in capture's cameras hear: the ball as it hits the floor and the bumpers. World units are meters."""

from __future__ import annotations

import numpy as np

from splatreel.capture.builtin.toyroom import impacts
from splatreel.capture.soundtrack import RATE

SPEED = 343.0
"""Of sound, meters a second."""
LOUDNESS = 1.6
"""Of an impact at a meter; a camera four meters away is well below full scale."""
MODES = {
    "floor": ((95.0, 0.045, 1.0), (210.0, 0.03, 0.7), (480.0, 0.014, 0.4), (1150.0, 0.006, 0.25)),
    "bumper": ((310.0, 0.03, 0.5), (720.0, 0.018, 0.6), (1640.0, 0.009, 0.45), (2900.0, 0.005, 0.3)),
}
"""How a thing rings when it is struck: hertz, seconds in which a mode falls to 1/e, and its share."""
CONTACT = 0.002
"""Seconds in which the noise of touching falls to 1/e; no two touches sound alike."""
NOISE = 1e-4
"""Root mean square of a microphone's own noise."""
LASTS = 0.3
"""Seconds after which an impact is over."""


def render_sound(center: np.ndarray, seconds: float, seed: int) -> np.ndarray:
    """[round(seconds * RATE)] float32 at a place [3]: every impact as late and as weak as its distance makes it, and noise.

    seed: of the noise; the same arguments give the same samples.
    """
    sound = np.random.default_rng(seed).normal(0, NOISE, round(seconds * RATE))
    for index, impact in enumerate(impacts(seconds)):
        distance = float(np.linalg.norm(np.array(impact.place) - center))
        arrival = (impact.time + distance / SPEED) * RATE
        part = sound[round(arrival) : round(arrival + LASTS * RATE)]
        part += LOUDNESS / distance * impact.strength * _strike(impact.on, index)[: len(part)]
    return np.clip(sound, -1, 1).astype(np.float32)


def _strike(on: str, index: int) -> np.ndarray:
    """What an impact sounds like at its place, at most about 1: noise as things touch, while what is struck rings."""
    ages = np.arange(round(LASTS * RATE) + 1) / RATE
    modes = MODES[on]
    ring = sum(share * np.exp(-ages / decay) * np.sin(2 * np.pi * hertz * ages) for hertz, decay, share in modes)
    touch = np.random.default_rng(index).normal(0, 0.3, len(ages)) * np.exp(-ages / CONTACT)
    return ring / sum(share for _, _, share in modes) + touch
