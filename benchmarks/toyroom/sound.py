"""Sound of the built-in capture: the ball hits the floor and the bumpers. World units are meters."""

from __future__ import annotations

import numpy as np

from splatreel.capture.capture_sound import RATE
from toyroom.room import impacts

SPEED = 343.0
"""Speed of sound, meters per second."""
LOUDNESS = 1.6
"""Amplitude of an impact at one meter. At four meters it stays well below full scale."""
MODES = {
    "floor": ((95.0, 0.045, 1.0), (210.0, 0.03, 0.7), (480.0, 0.014, 0.4), (1150.0, 0.006, 0.25)),
    "bumper": ((310.0, 0.03, 0.5), (720.0, 0.018, 0.6), (1640.0, 0.009, 0.45), (2900.0, 0.005, 0.3)),
}
"""Resonances of a struck object: frequency in hertz, decay time to 1/e in seconds, and share."""
CONTACT = 0.002
"""Seconds in which the contact noise decays to 1/e. Every contact has other noise."""
NOISE = 1e-4
"""Root mean square of a microphone's noise."""
LASTS = 0.3
"""Seconds after which an impact has ended."""


def render_sound(center: np.ndarray, seconds: float, seed: int) -> np.ndarray:
    """Return the sound at a position [3], [round(seconds * RATE)] float32: all impacts, delayed and attenuated by distance, plus noise.

    Args:
        center: Position of the microphone.
        seconds: Duration.
        seed: Seed of the noise. The same arguments give the same samples.
    """
    sound = np.random.default_rng(seed).normal(0, NOISE, round(seconds * RATE))
    for index, impact in enumerate(impacts(seconds)):
        distance = float(np.linalg.norm(np.array(impact.place) - center))
        arrival = (impact.time + distance / SPEED) * RATE
        part = sound[round(arrival) : round(arrival + LASTS * RATE)]
        part += LOUDNESS / distance * impact.strength * _strike(impact.on, index)[: len(part)]
    return np.clip(sound, -1, 1).astype(np.float32)


def _strike(on: str, index: int) -> np.ndarray:
    """Return the sound of an impact at its position, at most about 1: contact noise and the resonances of the struck object."""
    ages = np.arange(round(LASTS * RATE) + 1) / RATE
    modes = MODES[on]
    ring = sum(share * np.exp(-ages / decay) * np.sin(2 * np.pi * hertz * ages) for hertz, decay, share in modes)
    touch = np.random.default_rng(index).normal(0, 0.3, len(ages)) * np.exp(-ages / CONTACT)
    return ring / sum(share for _, _, share in modes) + touch
