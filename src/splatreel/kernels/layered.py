"""Photometric loss of splats among frozen splats, and its gradient, without a pass over the whole image.

If a tenth of a megapixel image changes, copying and clearing the unchanged rest would take longer than everything else.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from splatreel.base.jit import F2, F3, F4, L1, range_kernel
from splatreel.kernels import rasterize, similarity
from splatreel.kernels.binning import TILE, Bins, tiles_of

GRAIN = 64
"""Smallest number of tiles that is worth a thread."""


def loss_and_gradient(
    bins: Bins,
    colors: np.ndarray,
    frozen: rasterize.Frozen,
    target: np.ndarray,
    lambda_dssim: float,
    gain: np.ndarray | None,
    background: np.ndarray | None,
    where: np.ndarray | None = None,
    whole: bool = False,
    unknown: np.ndarray | None = None,
) -> tuple[float, rasterize.Gradients]:
    """Return the loss of (image + background) * gain against the target, see `similarity.loss_and_gradient`, and its gradients.

    The splats are drawn into the image of the frozen splats, which is restored afterwards. So two threads must not use the same frozen
    splats at once.

    Args:
        bins: The splats, sorted into tiles.
        colors: [N, 3].
        frozen: The frozen splats to draw among.
        target: [H, W, 3] float32, 0..1, or uint8.
        lambda_dssim: Weight of 1 - SSIM, 0..1.
        gain: [3]. None: 1.
        background: [3]. None: 0.
        where: [N] bool. If given, `bins` has all splats of the view, the frozen ones too, and only tiles that a splat of `where`
            touches are drawn and compared.
        whole: Whether the loss is that of the whole image. If not, it leaves out a constant, see `similarity.loss_and_gradient`.
        unknown: [H, W] bool, pixels without a target, which cause no loss. The target is uint8 then.
    """
    tiles = bins.counts > 0 if where is None else tiles_of(bins, where)
    among = frozen if where is None else None
    with _put_back(frozen, np.flatnonzero(tiles)):
        rasterize.draw_over(bins, colors, frozen, among, tiles)
        compared = None if whole else tiles.reshape(-(-bins.height // TILE), -1)
        if unknown is not None:
            target = _with_drawing(target, unknown, frozen.image, gain, background)
        found = similarity.loss_and_gradient(
            frozen.image, target, lambda_dssim, gain, compared, background, zeros=False
        )
        none = rasterize.no_gradient(frozen.alpha.shape)
        arguments = bins, colors, frozen.image, found.d_image, frozen.alpha, none, among
        gradients = rasterize.backward(*arguments, wanted=None if where is None else tiles)
    return found.loss, gradients


def _with_drawing(
    target: np.ndarray, unknown: np.ndarray, image: np.ndarray, gain: np.ndarray | None, background: np.ndarray | None
) -> np.ndarray:
    """Return a target [H, W, 3] uint8 whose unknown pixels [H, W] bool repeat the drawing."""
    drawn = image[unknown]
    drawn = drawn if background is None else drawn + background
    drawn = drawn if gain is None else drawn * gain
    found = target.copy()
    found[unknown] = np.rint(255 * np.clip(drawn, 0, 1)).astype(np.uint8)
    return found


@contextmanager
def _put_back(frozen: rasterize.Frozen, tiles: np.ndarray) -> Iterator[None]:
    """Restore tiles [K] of the image and of alpha after the `with` block."""
    held = np.empty((len(tiles), TILE, TILE, 4), np.float32)
    _keep.over(len(tiles), frozen.image, frozen.alpha, tiles, held, grain=GRAIN)
    try:
        yield
    finally:
        _restore.over(len(tiles), frozen.image, frozen.alpha, tiles, held, grain=GRAIN)


@range_kernel(F3, F2, L1, F4)
def _keep(first, last, image, alpha, tiles, held):
    across = (alpha.shape[1] + TILE - 1) // TILE
    for k in range(first, last):
        top, left = tiles[k] // across * TILE, tiles[k] % across * TILE
        for r in range(min(TILE, alpha.shape[0] - top)):
            for c in range(min(TILE, alpha.shape[1] - left)):
                for channel in range(3):
                    held[k, r, c, channel] = image[top + r, left + c, channel]
                held[k, r, c, 3] = alpha[top + r, left + c]


@range_kernel(F3, F2, L1, F4)
def _restore(first, last, image, alpha, tiles, held):
    across = (alpha.shape[1] + TILE - 1) // TILE
    for k in range(first, last):
        top, left = tiles[k] // across * TILE, tiles[k] % across * TILE
        for r in range(min(TILE, alpha.shape[0] - top)):
            for c in range(min(TILE, alpha.shape[1] - left)):
                for channel in range(3):
                    image[top + r, left + c, channel] = held[k, r, c, channel]
                alpha[top + r, left + c] = held[k, r, c, 3]
