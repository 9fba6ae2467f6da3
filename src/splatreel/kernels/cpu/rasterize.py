"""Tile rasterizer for the CPU: front-to-back alpha blending of sorted splats and its exact gradient."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from numba import njit, prange

from splatreel.kernels.cpu import blending
from splatreel.kernels.cpu.binning import LOG2_E, LOG_OPACITY, Bins, tiles_of
from splatreel.kernels.cpu.blending import PIXELS
from splatreel.kernels.cpu.jit import HALF, PARALLEL, SERIAL, TWO, ZERO, F

NOTHING = F(-100)
"""log2 of the opacity of what is not drawn."""


@dataclass(frozen=True)
class Frozen:
    """Splats that never change, as one view sees them. colors: [N, C]; image: [H, W, C] and alpha: [H, W], their picture."""

    bins: Bins
    colors: np.ndarray
    image: np.ndarray
    alpha: np.ndarray


Drawn = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""splats, colors, offsets, ids and rows of sorted splats: see `Bins`."""


def forward(bins: Bins, colors: np.ndarray, frozen: Frozen | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Blends colors [N, C], C 1 or 3, over black. Returns the image [H, W, C] and alpha [H, W].

    frozen: draw in front of and behind these, whose picture stays wherever none of the others is.
    """
    if frozen is None:
        image = np.empty((bins.height, bins.width, colors.shape[1]), np.float32)
        alpha = np.empty((bins.height, bins.width), np.float32)
    else:
        image, alpha = frozen.image.copy(), frozen.alpha.copy()
    kernel = blending.forward_1 if colors.shape[1] == 1 else blending.forward_3
    held = _held(bins, colors, frozen)
    kernel(_drawn(bins, colors), held, frozen is not None, _balanced(bins, frozen), image, alpha, _scratch())
    return image, alpha


def remove(frozen: Frozen, gone: np.ndarray) -> None:
    """Draw frozen splats anew without some of them, [K] int64; nothing else changes."""
    frozen.bins.splats[gone, LOG_OPACITY] = NOTHING
    without = np.zeros(len(frozen.bins.splats), np.bool_)
    without[gone] = True
    tiles = _balanced(frozen.bins, None, tiles_of(frozen.bins, without))
    drawn, held = _drawn(frozen.bins, frozen.colors), _held(frozen.bins, frozen.colors, None)
    kernel = blending.forward_1 if frozen.colors.shape[1] == 1 else blending.forward_3
    kernel(drawn, held, False, tiles, frozen.image, frozen.alpha, _scratch())


def draw_over(bins: Bins, colors: np.ndarray, frozen: Frozen, among: Frozen | None, near: np.ndarray) -> None:
    """Blend colors [N, 3] into the very picture of frozen splats. near: [tiles] bool, the only tiles where that is done.

    among: the frozen splats, or None to draw in their place.
    """
    drawn, held, tiles = _drawn(bins, colors), _held(bins, colors, among), _balanced(bins, among, near)
    blending.forward_3(drawn, held, among is not None, tiles, frozen.image, frozen.alpha, _scratch())


def backward(
    bins: Bins,
    colors: np.ndarray,
    image: np.ndarray,
    d_image: np.ndarray,
    alpha: np.ndarray,
    d_alpha: np.ndarray,
    frozen: Frozen | None = None,
    wanted: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gradients to means2d [N, 2], conics [N, 3], opacities [N] and colors [N, C].

    image and alpha are what `forward` returned. wanted: [tiles] bool, the only tiles whose pixels have a gradient; None: all. Every
    (splat, tile) pair has its own slot, summed in a fixed order: no atomics, and the same bits for any number of threads. Frozen splats
    only take light away; what lies behind the last splat that is not frozen matters to no gradient and is left out.
    """
    n, channels = colors.shape
    pairs = (np.empty if wanted is None else np.zeros)((bins.first[-1], 6 + channels), np.float32)
    kernel = blending.backward_1 if channels == 1 else blending.backward_3
    splats = _drawn(bins, colors), bins.slots, _held(bins, colors, frozen), frozen is not None
    kernel(*splats, _balanced(bins, frozen, wanted), image, alpha, d_image, d_alpha, pairs, _scratch())
    d_means2d, d_conics = np.empty((n, 2), np.float32), np.empty((n, 3), np.float32)
    d_opacities, d_colors = np.empty(n, np.float32), np.empty((n, channels), np.float32)
    _gather(bins.first, pairs, bins.splats, d_means2d, d_conics, d_opacities, d_colors)
    return d_means2d, d_conics, d_opacities, d_colors


@lru_cache(maxsize=8)
def no_gradient(shape: tuple[int, ...]) -> np.ndarray:
    """Zeros, shared, for what the loss does not depend on, as it mostly does not on alpha."""
    return np.zeros(shape, np.float32)


def _drawn(bins: Bins, colors: np.ndarray) -> Drawn:
    return bins.splats, colors, bins.offsets, bins.ids, bins.rows


def _held(bins: Bins, colors: np.ndarray, frozen: Frozen | None) -> Drawn:
    """The frozen splats as the kernels take them."""
    if frozen is None:
        return bins.splats[:0], colors[:0], np.zeros_like(bins.offsets), bins.ids[:0], bins.rows[:0]
    return _drawn(frozen.bins, frozen.colors)


def _balanced(bins: Bins, frozen: Frozen | None, wanted: np.ndarray | None = None) -> np.ndarray:
    """The tiles to draw, fullest first, dealt out so that the contiguous share each thread takes holds about equal work.

    Before frozen splats these are the tiles that others touch. wanted: [tiles] bool, no others.
    """
    chosen = np.ones(len(bins.counts), np.bool_) if frozen is None else bins.counts > 0
    if wanted is not None:
        chosen &= wanted
    held = np.zeros_like(bins.offsets) if frozen is None else frozen.bins.offsets
    return _deal(bins.offsets, held, np.flatnonzero(chosen), numba.get_num_threads())


@njit(**SERIAL)
def _deal(offsets, held, tiles, threads):
    size = tiles.shape[0]
    counts = np.empty(size, np.int64)
    for k in range(size):
        tile = tiles[k]
        counts[k] = -(offsets[tile + 1] - offsets[tile] + held[tile + 1] - held[tile])
    fullest_first = np.argsort(counts, kind="mergesort")
    dealt, position = np.empty(size, np.int64), 0
    for thread in range(threads):
        for k in range(thread, size, threads):
            dealt[position] = tiles[fullest_first[k]]
            position += 1
    return dealt


def _scratch() -> np.ndarray:
    """One row of planes a thread, aligned to 64 bytes: a full vector register."""
    planes, threads = 8, numba.get_num_threads()
    raw = np.empty(threads * planes * PIXELS + 16, np.float32)
    start = (-raw.ctypes.data % 64) // 4
    return raw[start : start + threads * planes * PIXELS].reshape(threads, planes * PIXELS)


@njit(**PARALLEL)
def _gather(first, pairs, splats, d_means2d, d_conics, d_opacities, d_colors):
    """Sums each splat's slots and turns the moments of d(log alpha) into gradients."""
    for i in prange(splats.shape[0]):
        m0 = mx = my = mxx = mxy = myy = ZERO
        for channel in range(d_colors.shape[1]):
            d_colors[i, channel] = ZERO
        for k in range(first[i], first[i + 1]):
            m0 += pairs[k, 0]
            mx += pairs[k, 1]
            my += pairs[k, 2]
            mxx += pairs[k, 3]
            mxy += pairs[k, 4]
            myy += pairs[k, 5]
            for channel in range(d_colors.shape[1]):
                d_colors[i, channel] += pairs[k, 6 + channel]
        d_means2d[i, 0] = d_means2d[i, 1] = d_conics[i, 0] = d_conics[i, 1] = d_conics[i, 2] = d_opacities[i] = ZERO
        if first[i] == first[i + 1]:
            continue
        a, b, c = TWO * splats[i, 2] / LOG2_E, splats[i, 3] / LOG2_E, TWO * splats[i, 4] / LOG2_E
        d_means2d[i, 0], d_means2d[i, 1] = a * mx + b * my, b * mx + c * my
        d_conics[i, 0], d_conics[i, 1], d_conics[i, 2] = -HALF * mxx, -mxy, -HALF * myy
        d_opacities[i] = m0 * F(2) ** -splats[i, 5]
