"""CPU rasterizer: front-to-back alpha blending of splats sorted into tiles, and its exact gradient."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from splatreel.base import threads
from splatreel.base.jit import F1, F2, I1, range_kernel
from splatreel.kernels import blending
from splatreel.kernels.binning import LOG2_E, LOG_OPACITY, Bins, tiles_of
from splatreel.kernels.blending import CHANNELS, GATHERED, PARTS
from splatreel.kernels.scalars import HALF, TWO, ZERO, F

SHARES = 4
"""Parts of the tiles per thread. A thread that finishes early takes over parts of threads that other programs delay."""
GRAIN = 1024
"""Smallest number of splats that is worth a thread."""
NOTHING = F(-100)
"""log2 of the opacity of removed splats."""


@dataclass(frozen=True)
class Frozen:
    """Splats of one view that do not change. colors: [N, 3]. image: [H, W, 3] and alpha: [H, W], the splats drawn alone."""

    bins: Bins
    colors: np.ndarray
    image: np.ndarray
    alpha: np.ndarray


class Gradients(NamedTuple):
    """Gradients of N splats.

    Attributes:
        absolute: [N, 2], sum over tiles of the absolute gradient to `means2d` of each tile.
    """

    means2d: np.ndarray
    conics: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    absolute: np.ndarray


Drawn = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""splats, colors, offsets, ids and rows of sorted splats, see `Bins`."""


def forward(bins: Bins, colors: np.ndarray, frozen: Frozen | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Blend splats with colors [N, 3] over black. Return the image [H, W, 3] and alpha [H, W].

    frozen: splats to draw among, by depth. Tiles that no other splat touches keep the image of the frozen splats.
    """
    if frozen is None:
        image = np.empty((bins.height, bins.width, colors.shape[1]), np.float32)
        alpha = np.empty((bins.height, bins.width), np.float32)
    else:
        image, alpha = frozen.image.copy(), frozen.alpha.copy()
    _blend(bins, colors, frozen, _balanced(bins, frozen), image, alpha)
    return image, alpha


def remove(frozen: Frozen, gone: np.ndarray) -> None:
    """Remove splats `gone`, [K] int64, from frozen splats, in place. Only the tiles that they touch are drawn again."""
    frozen.bins.splats[gone, LOG_OPACITY] = NOTHING
    without = np.zeros(len(frozen.bins.splats), np.bool_)
    without[gone] = True
    tiles = _balanced(frozen.bins, None, tiles_of(frozen.bins, without))
    _blend(frozen.bins, frozen.colors, None, tiles, frozen.image, frozen.alpha)


def draw_over(bins: Bins, colors: np.ndarray, frozen: Frozen, among: Frozen | None, near: np.ndarray) -> None:
    """Blend splats with colors [N, 3] into the image of frozen splats, in place.

    among: the frozen splats, to draw among them. None: replace them. near: [tiles] bool, the tiles to draw.
    """
    _blend(bins, colors, among, _balanced(bins, among, near), frozen.image, frozen.alpha)


def _blend(
    bins: Bins, colors: np.ndarray, among: Frozen | None, tiles: np.ndarray, image: np.ndarray, alpha: np.ndarray
) -> None:
    """Blend splats into the given tiles of an image."""
    splats = tiles, _drawn(bins, colors), _held(bins, colors, among), among is not None
    blending.forward.over(len(tiles), *splats, image, alpha, chunks=_chunks())


def backward(
    bins: Bins,
    colors: np.ndarray,
    image: np.ndarray,
    d_image: np.ndarray,
    alpha: np.ndarray,
    d_alpha: np.ndarray,
    frozen: Frozen | None = None,
    wanted: np.ndarray | None = None,
) -> Gradients:
    """Return the gradients of N splats.

    Every (splat, tile) pair has its own slot, and slots are summed in a fixed order. So there are no atomics, and the bits are the same
    for any number of threads. Frozen splats get no gradient, and those behind the last other splat of a tile are skipped.

    image and alpha are those that `forward` returned. wanted: [tiles] bool, the tiles whose pixels have a gradient. None: all.
    """
    n = len(colors)
    pairs = (np.empty if wanted is None else np.zeros)((bins.first[-1], PARTS), np.float32)
    tiles = _balanced(bins, frozen, wanted)
    splats = tiles, _drawn(bins, colors), bins.slots, _held(bins, colors, frozen), frozen is not None
    blending.backward.over(len(tiles), *splats, image, alpha, d_image, d_alpha, pairs, chunks=_chunks())
    found = Gradients(*[np.empty((n, size) if size else n, np.float32) for size in (2, 3, 0, CHANNELS, 2)])
    _gather.over(n, bins.first, pairs, bins.splats, *found, grain=GRAIN)
    return found


def gather(bins: Bins, images: np.ndarray) -> np.ndarray:
    """Return the sums [N, K] of images [H, W, K] over the pixels of N splats, weighted by each splat's share of a pixel."""
    n, channels = len(bins.splats), images.shape[2]
    tiles, sums = _balanced(bins, None), np.empty((n, channels), np.float32)
    pairs = np.empty((bins.first[-1], GATHERED), np.float32)
    for start in range(0, channels, GATHERED):
        some = slice(start, min(start + GATHERED, channels))
        part = np.zeros((*images.shape[:2], GATHERED), np.float32)
        part[..., : some.stop - start] = images[..., some]
        lists = bins.splats, bins.offsets, bins.ids, bins.rows, bins.slots
        blending.gather.over(len(tiles), tiles, *lists, part, pairs, chunks=_chunks())
        found = np.empty((n, GATHERED), np.float32)
        _sum_slots.over(n, bins.first, pairs, found, grain=GRAIN)
        sums[:, some] = found[:, : some.stop - start]
    return sums


@lru_cache(maxsize=8)
def no_gradient(shape: tuple[int, ...]) -> np.ndarray:
    """Return zeros, shared between calls, for values that the loss does not depend on, such as alpha in most losses."""
    return np.zeros(shape, np.float32)


def _drawn(bins: Bins, colors: np.ndarray) -> Drawn:
    return bins.splats, colors, bins.offsets, bins.ids, bins.rows


def _held(bins: Bins, colors: np.ndarray, frozen: Frozen | None) -> Drawn:
    """Return the frozen splats in the form that the kernels take; empty arrays if there are none."""
    if frozen is None:
        return bins.splats[:0], colors[:0], np.zeros_like(bins.offsets), bins.ids[:0], bins.rows[:0]
    return _drawn(frozen.bins, frozen.colors)


def _balanced(bins: Bins, frozen: Frozen | None, wanted: np.ndarray | None = None) -> np.ndarray:
    """Return the tiles to draw, in an order whose contiguous parts hold about equal work, each with the fullest tile first.

    With frozen splats, only tiles that other splats touch are drawn. wanted: [tiles] bool limits the tiles further.
    """
    chosen = np.ones(len(bins.counts), np.bool_) if frozen is None else bins.counts > 0
    if wanted is not None:
        chosen &= wanted
    counts = bins.counts if frozen is None else bins.counts + frozen.bins.counts
    tiles, hands = np.flatnonzero(chosen), _chunks()
    fullest_first = tiles[np.argsort(-counts[tiles], kind="stable")]
    return np.concatenate([fullest_first[hand::hands] for hand in range(hands)])


def _chunks() -> int:
    """Return the number of parts that the tiles are divided into."""
    workers = threads.count()
    return workers * SHARES if workers > 1 else 1


@range_kernel(I1, F2, F2)
def _sum_slots(begin, end, first, pairs, sums):
    """Sum the slots of each splat."""
    for i in range(begin, end):
        for channel in range(sums.shape[1]):
            sums[i, channel] = ZERO
        for k in range(first[i], first[i + 1]):
            for channel in range(sums.shape[1]):
                sums[i, channel] += pairs[k, channel]


@range_kernel(I1, F2, F2, F2, F2, F1, F2, F2)
def _gather(begin, end, first, pairs, splats, d_means2d, d_conics, d_opacities, d_colors, absolute):
    """Sum the slots of each splat, and convert the moments of d(log alpha) to gradients."""
    for i in range(begin, end):
        m0 = mx = my = mxx = mxy = myy = across = down = ZERO
        for channel in range(d_colors.shape[1]):
            d_colors[i, channel] = ZERO
        a, b, c = TWO * splats[i, 2] / LOG2_E, splats[i, 3] / LOG2_E, TWO * splats[i, 4] / LOG2_E
        for k in range(first[i], first[i + 1]):
            m0 += pairs[k, 0]
            mx += pairs[k, 1]
            my += pairs[k, 2]
            mxx += pairs[k, 3]
            mxy += pairs[k, 4]
            myy += pairs[k, 5]
            across += abs(a * pairs[k, 1] + b * pairs[k, 2])
            down += abs(b * pairs[k, 1] + c * pairs[k, 2])
            for channel in range(d_colors.shape[1]):
                d_colors[i, channel] += pairs[k, 6 + channel]
        d_means2d[i, 0] = d_means2d[i, 1] = d_conics[i, 0] = d_conics[i, 1] = d_conics[i, 2] = d_opacities[i] = ZERO
        absolute[i, 0], absolute[i, 1] = across, down
        if first[i] == first[i + 1]:
            continue
        d_means2d[i, 0], d_means2d[i, 1] = a * mx + b * my, b * mx + c * my
        d_conics[i, 0], d_conics[i, 1], d_conics[i, 2] = -HALF * mxx, -mxy, -HALF * myy
        d_opacities[i] = m0 * F(2) ** -splats[i, 5]
