"""Tile rasteriser for the CPU: front-to-back alpha blending and its exact gradient.

One task renders one 16 x 16 tile in a small scratch that stays in the first-level cache: planes of 256 floats, one a
quantity, at constant offsets, so that LLVM can prove the planes independent and turn the loop over a splat's rows of
pixels into vector code. That is worth a factor of ten, and easily lost: keep the index unsigned (`U`), the offsets
constant, one flat loop, and no reduction but sums. A test looks for the vector registers in the machine code.

Transmittance is kept per pixel; its sign says whether the pixel still takes light: it turns negative once the next
splat would leave 1e-4 or less, as in gsplat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numba import get_thread_id, njit, prange  # pyright: ignore[reportPrivateImportUsage]

from splatreel.kernels.cpu.binning import DEPTH, LOG2_E, MIN_ALPHA, TILE, Bins
from splatreel.kernels.cpu.jit import HALF, ONE, PARALLEL, TWO, ZERO, F, U

MAX_ALPHA = F(0.999)
MIN_TRANSMITTANCE = F(1e-4)
PIXELS = TILE * TILE
CHECK = 16  # splats between two looks at whether all pixels of the tile are full

# 2^(e/8) for e in -8..0 as a polynomial; its eighth power is 2^e to 1.5e-6. Numba's wheels bring no vector exp.
P1, P2, P3, P4, P5, P6 = (
    F(0.08664337545633316),
    F(0.0037534991279244423),
    F(0.00010837755689863116),
    F(2.338086460440536e-06),
    F(3.884498056550001e-08),
    F(4.1371553405333827e-10),
)
MIN_EXPONENT = F(-8)  # below 1/255, so such alphas are dropped anyway


@dataclass(frozen=True)
class Frozen:
    """Splats that never change, as one view sees them. colors: [N, C]; image: [H, W, C] and alpha: [H, W], their picture."""

    bins: Bins
    colors: np.ndarray
    image: np.ndarray
    alpha: np.ndarray


def forward(bins: Bins, colors: np.ndarray, frozen: Frozen | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Blends colors [N, C], C 1 or 3, over black. Returns the image [H, W, C] and alpha [H, W].

    frozen: draw in front of and behind these, whose picture stays wherever none of the others is.
    """
    if frozen is None:
        image = np.empty((bins.height, bins.width, colors.shape[1]), np.float32)
        alpha = np.empty((bins.height, bins.width), np.float32)
    else:
        image, alpha = frozen.image.copy(), frozen.alpha.copy()
    kernel = _forward_1 if colors.shape[1] == 1 else _forward_3
    pairs = bins.offsets, bins.ids, bins.rows
    kernel(
        bins.splats, colors, *pairs, *_behind(bins, colors, frozen), _balanced(bins, frozen), image, alpha, _scratch()
    )
    return image, alpha


def backward(
    bins: Bins,
    colors: np.ndarray,
    image: np.ndarray,
    d_image: np.ndarray,
    alpha: np.ndarray,
    d_alpha: np.ndarray,
    frozen: Frozen | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gradients to means2d [N, 2], conics [N, 3], opacities [N] and colors [N, C].

    image and alpha are what `forward` returned. Every (splat, tile) pair has its own slot, summed in a fixed order: no
    atomics, and the same bits for any number of threads. Frozen splats only take light away; what lies behind the last
    splat that is not frozen matters to no gradient and is left out.
    """
    n, channels = colors.shape
    pairs = np.empty((bins.first[-1], 6 + channels), np.float32)
    kernel = _backward_1 if channels == 1 else _backward_3
    splats = (bins.splats, colors, bins.offsets, bins.ids, bins.rows, bins.slots, *_behind(bins, colors, frozen))
    kernel(*splats, _balanced(bins, frozen), image, alpha, d_image, d_alpha, pairs, _scratch())
    d_means2d, d_conics = np.empty((n, 2), np.float32), np.empty((n, 3), np.float32)
    d_opacities, d_colors = np.empty(n, np.float32), np.empty((n, channels), np.float32)
    _gather(bins.first, pairs, bins.splats, d_means2d, d_conics, d_opacities, d_colors)
    return d_means2d, d_conics, d_opacities, d_colors


def _behind(bins: Bins, colors: np.ndarray, frozen: Frozen | None) -> tuple:
    """The frozen splats as the kernels take them, and whether there are any."""
    if frozen is None:
        return bins.splats[:0], colors[:0], np.zeros_like(bins.offsets), bins.ids[:0], bins.rows[:0], False
    held = frozen.bins
    return held.splats, frozen.colors, held.offsets, held.ids, held.rows, True


def _balanced(bins: Bins, frozen: Frozen | None) -> np.ndarray:
    """The tiles to draw, fullest first, dealt out so that the contiguous share each thread takes holds about equal work."""
    counts = bins.counts if frozen is None else bins.counts + (bins.counts > 0) * frozen.bins.counts
    fullest_first = np.argsort(-counts, kind="stable")
    if frozen is not None:
        fullest_first = fullest_first[: np.count_nonzero(bins.counts)]
    threads = numba.get_num_threads()
    return np.concatenate([fullest_first[k::threads] for k in range(threads)])


def _scratch() -> np.ndarray:
    """One row of planes a thread, aligned to 64 bytes: a full vector register."""
    planes, threads = 8, numba.get_num_threads()
    raw = np.empty(threads * planes * PIXELS + 16, np.float32)
    start = (-raw.ctypes.data % 64) // 4
    return raw[start : start + threads * planes * PIXELS].reshape(threads, planes * PIXELS)


# Scratch planes. Both passes: transmittance, pixel centre x and y. Forward: then the colour accumulated.
X, Y, RGB = PIXELS, 2 * PIXELS, 3 * PIXELS
# Backward: then the remainder (what splats behind contribute to the loss), gradient to alpha, gradient to colour.
REST, D_ALPHA, D_RGB = 3 * PIXELS, 4 * PIXELS, 5 * PIXELS


@njit(inline="always")
def _exp2(e):
    e = max(e, MIN_EXPONENT)
    p = P6 * e + P5
    p = p * e + P4
    p = p * e + P3
    p = p * e + P2
    p = p * e + P1
    p = p * e + ONE
    p = p * p
    p = p * p
    return p * p


@njit(inline="always")
def _blend(alpha, transmittance):
    """Weight of a splat in a pixel, and the transmittance behind it (negative once the pixel is full)."""
    live = ONE if transmittance > ZERO else ZERO
    weight = (alpha * live if alpha >= MIN_ALPHA else ZERO) * transmittance
    behind = transmittance - weight
    weight *= ONE if behind > MIN_TRANSMITTANCE else ZERO
    return weight, behind if behind > MIN_TRANSMITTANCE else -abs(transmittance)


@njit(inline="always")
def _is_full(buffer):
    open_pixels = ZERO
    for p in range(U(0), U(PIXELS)):
        open_pixels += ONE if buffer[p] > ZERO else ZERO
    return open_pixels == ZERO


@njit(inline="always")
def _extent(rows, start, end, some):
    """First and last row of a tile to draw: where any of its splats is if `some`, else all."""
    if not some:
        return 0, TILE - 1
    first, last = TILE - 1, 0
    for k in range(start, end):
        first, last = min(first, rows[k] // TILE), max(last, rows[k] % TILE)
    return first, last


@njit(inline="always")
def _start(buffer, top, left, first, last, shape):
    """Fills a tile's pixel centres and transmittance; pixels outside the image or the rows first..last are full."""
    for r in range(TILE):
        for x in range(TILE):
            p = r * TILE + x
            inside = first <= r <= last and top + r < shape[0] and left + x < shape[1]
            buffer[p] = ONE if inside else -ONE
            buffer[X + p], buffer[Y + p] = F(left + x) + HALF, F(top + r) + HALF


@njit(inline="always")
def _start_gradient(buffer, top, left, image, alpha, d_image, d_alpha):
    """Fills a tile's planes of gradients; pixels outside the image have none."""
    for r in range(TILE):
        for x in range(TILE):
            p = r * TILE + x
            inside = top + r < alpha.shape[0] and left + x < alpha.shape[1]
            gradient = d_alpha[top + r, left + x] if inside else ZERO
            rest = gradient * alpha[top + r, left + x] if inside else ZERO
            buffer[D_ALPHA + p] = gradient
            for channel in range(d_image.shape[2]):
                gradient = d_image[top + r, left + x, channel] if inside else ZERO
                rest += gradient * image[top + r, left + x, channel] if inside else ZERO
                buffer[D_RGB + channel * PIXELS + p] = gradient
            buffer[REST + p] = rest


def _make_forward(channels: int):
    """The forward kernel for 1 or 3 channels; `rgb` is a constant to the compiler, so unused channels cost nothing.

    Two lists of splats are merged by depth as they are drawn, those whose names begin with h (held) are frozen ones.
    """
    rgb = channels == 3

    @njit(**PARALLEL)
    def forward_kernel(
        splats,
        colors,
        offsets,
        ids,
        rows,
        h_splats,
        h_colors,
        h_offsets,
        h_ids,
        h_rows,
        some,
        tiles,
        image,
        alpha,
        scratch,
    ):
        tiles_x = (alpha.shape[1] + TILE - 1) // TILE
        for task in prange(tiles.shape[0]):
            buffer = scratch[get_thread_id()]
            tile = tiles[task]
            top, left = tile // tiles_x * TILE, tile % tiles_x * TILE
            k, end, h, h_end = offsets[tile], offsets[tile + 1], h_offsets[tile], h_offsets[tile + 1]
            highest, lowest = _extent(rows, k, end, some)
            _start(buffer, top, left, highest, lowest, alpha.shape)
            for p in range(U(RGB), U(RGB + channels * PIXELS)):
                buffer[p] = ZERO
            while k < end or h < h_end:
                if h < h_end and (k == end or h_splats[h_ids[h], DEPTH] < splats[ids[k], DEPTH]):
                    i, reach = h_ids[h], h_rows[h]
                    x, y, a, b, c, log_opacity, _, _ = h_splats[i]
                    red = h_colors[i, 0]
                    green, blue = h_colors[i, 1] if rgb else ZERO, h_colors[i, 2] if rgb else ZERO
                    h += 1
                else:
                    i, reach = ids[k], rows[k]
                    x, y, a, b, c, log_opacity, _, _ = splats[i]
                    red = colors[i, 0]
                    green, blue = colors[i, 1] if rgb else ZERO, colors[i, 2] if rgb else ZERO
                    k += 1
                first, last = max(reach // TILE, highest), min(reach % TILE, lowest)
                for p in range(U(first * TILE), U(max(last + 1, first) * TILE)):
                    dx, dy = buffer[U(X) + p] - x, buffer[U(Y) + p] - y
                    opacity = _exp2(log_opacity - a * dx * dx - dy * (b * dx + c * dy))
                    weight, behind = _blend(min(opacity, MAX_ALPHA), buffer[p])
                    buffer[p] = behind
                    buffer[U(RGB) + p] += weight * red
                    if rgb:
                        buffer[U(RGB + PIXELS) + p] += weight * green
                        buffer[U(RGB + 2 * PIXELS) + p] += weight * blue
                if (k + h) % CHECK == 0 and _is_full(buffer):
                    break
            for r in range(highest, min(lowest + 1, alpha.shape[0] - top)):
                for x in range(min(TILE, alpha.shape[1] - left)):
                    p = r * TILE + x
                    alpha[top + r, left + x] = ONE - abs(buffer[p])
                    for channel in range(channels):
                        image[top + r, left + x, channel] = buffer[RGB + channel * PIXELS + p]

    return forward_kernel


def _make_backward(channels: int):
    """The backward kernel for 1 or 3 channels, front to back as the forward one.

    `rest` starts as the gradient-weighted colour and alpha of the pixel and loses each splat's share in turn, so that
    what remains belongs to the splats behind: no transmittance need be stored or divided back. Six moments of
    d(log alpha) over the pixels are all that mean, conic and opacity gradients need; `_gather` turns them into those.
    """
    rgb = channels == 3

    @njit(**PARALLEL)
    def backward_kernel(
        splats,
        colors,
        offsets,
        ids,
        rows,
        slots,
        h_splats,
        h_colors,
        h_offsets,
        h_ids,
        h_rows,
        some,
        tiles,
        image,
        alpha,
        d_image,
        d_alpha,
        pairs,
        scratch,
    ):
        tiles_x = (alpha.shape[1] + TILE - 1) // TILE
        for task in prange(tiles.shape[0]):
            buffer = scratch[get_thread_id()]
            tile = tiles[task]
            top, left = tile // tiles_x * TILE, tile % tiles_x * TILE
            k, end, h, h_end = offsets[tile], offsets[tile + 1], h_offsets[tile], h_offsets[tile + 1]
            highest, lowest = _extent(rows, k, end, some)
            _start(buffer, top, left, highest, lowest, alpha.shape)
            _start_gradient(buffer, top, left, image, alpha, d_image, d_alpha)
            while k < end:
                if (k + h) % CHECK == 0 and _is_full(buffer):
                    break
                if h < h_end and h_splats[h_ids[h], DEPTH] < splats[ids[k], DEPTH]:
                    i, reach = h_ids[h], h_rows[h]
                    h += 1
                    x, y, a, b, c, log_opacity, _, _ = h_splats[i]
                    red = h_colors[i, 0]
                    green, blue = h_colors[i, 1] if rgb else ZERO, h_colors[i, 2] if rgb else ZERO
                    first, last = max(reach // TILE, highest), min(reach % TILE, lowest)
                    for p in range(U(first * TILE), U(max(last + 1, first) * TILE)):
                        dx, dy = buffer[U(X) + p] - x, buffer[U(Y) + p] - y
                        opacity = _exp2(log_opacity - a * dx * dx - dy * (b * dx + c * dy))
                        weight, behind = _blend(min(opacity, MAX_ALPHA), buffer[p])
                        buffer[p] = behind
                        value = buffer[U(D_ALPHA) + p] + red * buffer[U(D_RGB) + p]
                        if rgb:
                            value += green * buffer[U(D_RGB + PIXELS) + p] + blue * buffer[U(D_RGB + 2 * PIXELS) + p]
                        buffer[U(REST) + p] -= weight * value
                    continue
                i, first, last = ids[k], rows[k] // TILE, rows[k] % TILE
                x, y, a, b, c, log_opacity, _, _ = splats[i]
                red = colors[i, 0]
                green, blue = colors[i, 1] if rgb else ZERO, colors[i, 2] if rgb else ZERO
                m0 = mx = my = mxx = mxy = myy = d_red = d_green = d_blue = ZERO
                for p in range(U(first * TILE), U(last * TILE + TILE)):
                    dx, dy = buffer[U(X) + p] - x, buffer[U(Y) + p] - y
                    opacity = _exp2(log_opacity - a * dx * dx - dy * (b * dx + c * dy))
                    clamped = min(opacity, MAX_ALPHA)
                    in_front = buffer[p]
                    weight, behind = _blend(clamped, in_front)
                    buffer[p] = behind
                    value = buffer[U(D_ALPHA) + p] + red * buffer[U(D_RGB) + p]
                    d_red += weight * buffer[U(D_RGB) + p]
                    if rgb:
                        value += green * buffer[U(D_RGB + PIXELS) + p] + blue * buffer[U(D_RGB + 2 * PIXELS) + p]
                        d_green += weight * buffer[U(D_RGB + PIXELS) + p]
                        d_blue += weight * buffer[U(D_RGB + 2 * PIXELS) + p]
                    rest = buffer[U(REST) + p] - weight * value
                    buffer[U(REST) + p] = rest
                    d_clamped = in_front * value - rest / (ONE - clamped)
                    drawn = opacity if opacity <= MAX_ALPHA else ZERO  # no gradient through the clamp
                    moment = (drawn if weight > ZERO else ZERO) * d_clamped
                    moment_x, moment_y = moment * dx, moment * dy
                    m0 += moment
                    mx += moment_x
                    my += moment_y
                    mxx += moment_x * dx
                    mxy += moment_x * dy
                    myy += moment_y * dy
                slot = slots[k]
                pairs[slot, 0], pairs[slot, 1], pairs[slot, 2] = m0, mx, my
                pairs[slot, 3], pairs[slot, 4], pairs[slot, 5] = mxx, mxy, myy
                pairs[slot, 6] = d_red
                if rgb:
                    pairs[slot, 7], pairs[slot, 8] = d_green, d_blue
                k += 1
            for hidden in range(k, end):
                for j in range(6 + channels):
                    pairs[slots[hidden], j] = ZERO

    return backward_kernel


_forward_1, _forward_3 = _make_forward(1), _make_forward(3)
_backward_1, _backward_3 = _make_backward(1), _make_backward(3)


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
