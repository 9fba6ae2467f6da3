"""Maps: values of points as images, in Morton order within blocks, so that spatial neighbors are neighboring pixels.

Source:
    Paper, section 4.3.
"""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.codec.quantize import Parameters, integer

BLOCK = 16
"""Side of the blocks in pixels; widths and heights are multiples of it."""
_MIN_SIDE = 64
"""Side of one coding tree unit. x265 corrupts memory on images of 48 x 16 pixels."""
MAX_SLACK = 4096
"""Pixels that a map may have beyond its points."""


def size_of(count: int) -> tuple[int, int]:
    """Return width and height of the map of `count` points."""
    width = max(int(np.ceil(count**0.5 / BLOCK)) * BLOCK, _MIN_SIDE)
    return width, max(int(np.ceil(count / (width * BLOCK))) * BLOCK, _MIN_SIDE)


def decode_size(parameters: Parameters, count: int) -> tuple[int, int]:
    """Return the width and height that a section names. Raise `ReelError` if they do not fit `count` points."""
    width, height = (integer(parameters, side, BLOCK, 8192) for side in ("width", "height"))
    if width % BLOCK or height % BLOCK or not count <= width * height <= 2 * count + MAX_SLACK:
        raise ReelError(f"has maps of {width} x {height} pixels, which do not fit {count} points.")
    return width, height


def pixels_of(count: int, width: int) -> np.ndarray:
    """Return the pixel index [count] of each point in a map of the given width: Z-order in blocks, blocks boustrophedon."""
    index = np.arange(count)
    block, inside = index >> 8, index & 255
    x, y = _even_bits(inside), _even_bits(inside >> 1)
    row, column = np.divmod(block, width // BLOCK)
    column = np.where(row & 1, width // BLOCK - 1 - column, column)
    return (row * BLOCK + y) * width + column * BLOCK + x


def _even_bits(value: np.ndarray) -> np.ndarray:
    return (value & 1) | (value >> 1 & 2) | (value >> 2 & 4) | (value >> 3 & 8)


def to_maps(values: np.ndarray, pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return images [T, height, C * width] uint8 of values [T, N, C], one tile per channel, side by side."""
    frames, _, channels = values.shape
    maps = np.empty((frames, channels, height * width), np.uint8)
    maps[:] = values[:, -1, :, None]
    maps[:, :, pixels] = values.transpose(0, 2, 1)
    tiles = maps.reshape(frames, channels, height, width).transpose(0, 2, 1, 3)
    return np.ascontiguousarray(tiles.reshape(frames, height, channels * width))


def from_maps(maps: np.ndarray, pixels: np.ndarray, width: int) -> np.ndarray:
    """Return values [T, N, C] of images [T, height, C * width]."""
    frames, height, total = maps.shape
    tiles = maps.reshape(frames, height, total // width, width).transpose(0, 1, 3, 2)
    return np.ascontiguousarray(tiles).reshape(frames, height * width, -1)[:, pixels]
