"""Section `light`: brightness factors of a group per frame (not in the paper)."""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.codec import quantize
from splatreel.codec.section import Section, Sections, named, section_of

BITS = 12
"""Bits of the logarithms. If the light halves, a step is a thirtieth of a gray level."""
MOST = 1024.0
"""Maximum factor by which the light may brighten or darken."""


def encode_light(light: np.ndarray) -> Sections:
    """Encode the factors `Group.light`, [T, 3]."""
    return {"light": Section(*quantize.encode_linear(np.clip(light, 1 / MOST, MOST), BITS, log=True))}


def decode_light(sections: Sections, frames: int) -> np.ndarray:
    """Decode the factors, [T, 3] float32. Raise `ReelError` if the section is damaged."""
    section = section_of(sections, "light", "linear")
    light = named("light", quantize.decode_linear, section.data, section.parameters, frames, 3)
    if not ((light > 0.99 / MOST) & (light < 1.01 * MOST)).all():
        raise ReelError(
            f"section 'light' has factors from {light.min():.3g} to {light.max():.3g}, not within {MOST:g} of 1."
        )
    return light
