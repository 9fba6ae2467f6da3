"""Conversion of pixel values to 8-bit sRGB: wide gamuts, high dynamic range and transparency."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

BT2020, P3 = 9, 12
"""Primaries of wide gamuts, by their numbers in ITU-T H.273."""
PQ, HLG = 16, 18
"""Transfer functions of high dynamic range, by their numbers in ITU-T H.273."""
TO_SRGB = {
    BT2020: [[1.660491, -0.587641, -0.072850], [-0.124550, 1.132900, -0.008349], [-0.018151, -0.100579, 1.118730]],
    P3: [[1.224940, -0.224940, 0.0], [-0.042057, 1.042057, 0.0], [-0.019638, -0.078636, 1.098274]],
}
"""Matrices from linear light of a wide gamut to that of sRGB, all with the white D65."""
REFERENCE_WHITE = 203.0
"""Luminance of white in PQ, cd/m^2. Source: ITU-R BT.2408."""
HLG_WHITE = 0.75
"""Signal of white in HLG. Source: ITU-R BT.2408."""
FULL = 255 << 8
"""Largest R'G'B' value that FFmpeg makes of Y'CbCr with 16 bits per channel."""
STEPS = 1 << 14
"""Steps of linear light from black to white, fine enough for 8 bits of sRGB in the dark."""
ROWS = 16
"""Rows converted at a time, which fit into a processor's cache."""


class SrgbConversion:
    """Conversion of FFmpeg's 16-bit R'G'B' to 8-bit sRGB.

    Light above white and colors outside sRGB are clipped, as by the sensor of a camera that records sRGB.

    Args:
        primaries: Primaries of the input, 0 for those of sRGB.
        transfer: PQ, HLG, or 0 for the transfer function of sRGB, which stands for those of all SDR videos.
    """

    def __init__(self, primaries: int, transfer: int) -> None:
        signal = np.minimum(np.arange(1 << 16) / FULL, 1)
        light = pq_light(signal) if transfer == PQ else hlg_light(signal) if transfer == HLG else srgb_light(signal)
        self._light = (light * (STEPS - 1)).astype(np.float32)
        self._matrix = np.array(TO_SRGB.get(primaries, np.eye(3)), np.float32).T
        self._codes = np.rint(255 * srgb_signal(np.linspace(0, 1, STEPS))).astype(np.uint8)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Convert [H, W, 3] uint16 to uint8."""
        out = np.empty(image.shape, np.uint8)
        for row in range(0, len(image), ROWS):
            part = image[row : row + ROWS]
            light = self._light[part].reshape(-1, 3) @ self._matrix
            light += 0.5
            np.clip(light, 0, STEPS - 1, out=light)
            out[row : row + ROWS] = self._codes[light.astype(np.uint16)].reshape(part.shape)
        return out


@lru_cache(maxsize=8)
def srgb_conversion(primaries: int, transfer: int) -> SrgbConversion:
    """Return the conversion of these primaries and this transfer function."""
    return SrgbConversion(primaries, transfer)


def srgb_light(signal: np.ndarray) -> np.ndarray:
    """Return the linear light of an sRGB signal, both 0..1."""
    return np.where(signal <= 0.04045, signal / 12.92, ((signal + 0.055) / 1.055) ** 2.4)


def srgb_signal(light: np.ndarray) -> np.ndarray:
    """Return the sRGB signal of linear light, both 0..1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def hlg_light(signal: np.ndarray) -> np.ndarray:
    """Return the light in front of the camera for an HLG signal 0..1, relative to white.

    Source: ITU-R BT.2100, table 5, inverse of the OETF.
    """

    def scene(value: np.ndarray) -> np.ndarray:
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        return np.where(value <= 0.5, value**2 / 3, (np.exp((value - c) / a) + b) / 12)

    return scene(signal) / scene(np.array(HLG_WHITE))


def pq_light(signal: np.ndarray) -> np.ndarray:
    """Return the light of a screen for a PQ signal 0..1, relative to white. Source: ITU-R BT.2100, table 4, EOTF."""
    m1, m2, c1, c2, c3 = 1305 / 8192, 2523 / 32, 107 / 128, 2413 / 128, 2392 / 128
    root = signal ** (1 / m2)
    return (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1) * (10000 / REFERENCE_WHITE)


def over_black(image: np.ndarray) -> np.ndarray:
    """Return straight alpha [H, W, 4] uint8 or uint16 composed over black, [H, W, 3]."""
    return over_color(image[..., :3], image[..., 3], (0, 0, 0))


def over_color(image: np.ndarray, alpha: np.ndarray, color: Sequence[int] | np.ndarray) -> np.ndarray:
    """Compose an image over a color. sRGB values are blended, as in 3DGS.

    Args:
        image: [H, W, 3] uint8 or uint16, straight.
        alpha: [H, W] of the same type.
        color: Red, green and blue of the same range.
    """
    full = np.iinfo(image.dtype).max
    if alpha.min(initial=full) == full:
        return image
    alpha = alpha[..., None].astype(np.uint32)
    behind = (full - alpha) * np.asarray(color, np.uint32)
    return ((image * alpha + behind + full // 2) // full).astype(image.dtype)
