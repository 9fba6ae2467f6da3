"""Tile rasteriser for the CPU: front-to-back alpha blending and its exact gradient.

One task renders one 16 x 16 tile in a small scratch that stays in the first-level cache: planes of 256 floats, one a
quantity, at constant offsets, so that LLVM can prove the planes independent and turn the loop over a splat's rows of
pixels into vector code. That is worth a factor of ten, and easily lost: keep the index unsigned (`U`), the offsets
constant, one flat loop, and no reduction but sums. A test looks for the vector registers in the machine code.

Transmittance is kept per pixel; its sign says whether the pixel still takes light: it turns negative once the next
splat would leave 1e-4 or less, as in gsplat.
"""

from __future__ import annotations

import numba
import numpy as np
from numba import get_thread_id, njit, prange  # pyright: ignore[reportPrivateImportUsage]

from splatreel.kernels.cpu.binning import LOG2_E, MIN_ALPHA, TILE, Bins
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


def forward(
    bins: Bins, colors: np.ndarray, still: tuple[np.ndarray, np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Blends colors [N, C], C 1 or 3, over black. Returns the image [H, W, C] and alpha [H, W].

    still: an image and alpha to keep where the bins want no tile.
    """
    if still is None:
        image = np.empty((bins.height, bins.width, colors.shape[1]), np.float32)
        alpha = np.empty((bins.height, bins.width), np.float32)
    else:
        image, alpha = still[0].copy(), still[1].copy()
    kernel = _forward_1 if colors.shape[1] == 1 else _forward_3
    tiles = _balanced(bins, bins.offsets[1:])
    kernel(bins.splats, bins.spans, colors, bins.offsets, bins.ids, tiles, image, alpha, _scratch())
    return image, alpha


def backward(
    bins: Bins,
    colors: np.ndarray,
    image: np.ndarray,
    d_image: np.ndarray,
    alpha: np.ndarray,
    d_alpha: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gradients to means2d [N, 2], conics [N, 3], opacities [N] and colors [N, C].

    image and alpha are what `forward` returned. Every (splat, tile) pair has its own slot, summed in a fixed order: no
    atomics, and the same bits for any number of threads. Frozen splats only take light away; what lies behind the last
    splat that is not frozen matters to no gradient and is left out.
    """
    n, channels = colors.shape
    pairs = np.empty((bins.first[-1], 6 + channels), np.float32)
    kernel = _backward_1 if channels == 1 else _backward_3
    tiles = (bins.offsets, bins.ends, bins.ids, bins.slots, _balanced(bins, bins.ends))
    kernel(bins.splats, bins.spans, colors, *tiles, image, alpha, d_image, d_alpha, pairs, _scratch())
    d_means2d, d_conics = np.empty((n, 2), np.float32), np.empty((n, 3), np.float32)
    d_opacities, d_colors = np.empty(n, np.float32), np.empty((n, channels), np.float32)
    _gather(bins.first, pairs, bins.splats, d_means2d, d_conics, d_opacities, d_colors)
    return d_means2d, d_conics, d_opacities, d_colors


def _balanced(bins: Bins, ends: np.ndarray) -> np.ndarray:
    """The wanted tiles, fullest first, dealt out so that the contiguous share each thread takes holds about equal work.

    ends: [tiles], one past the last pair of each tile that is looked at.
    """
    fullest_first = np.argsort(bins.offsets[:-1] - ends, kind="stable")
    fullest_first = fullest_first[bins.wanted.ravel()[fullest_first]]
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
def _start_backward(buffer, top, left, image, alpha, d_image, d_alpha):
    """Fills a tile's planes for the backward pass; pixels outside the image are full and have no gradient."""
    rows, columns = min(TILE, alpha.shape[0] - top), min(TILE, alpha.shape[1] - left)
    for r in range(TILE):
        for x in range(TILE):
            p = r * TILE + x
            inside = r < rows and x < columns
            buffer[p] = ONE if inside else -ONE
            buffer[X + p], buffer[Y + p] = F(left + x) + HALF, F(top + r) + HALF
            gradient = d_alpha[top + r, left + x] if inside else ZERO
            rest = gradient * alpha[top + r, left + x] if inside else ZERO
            buffer[D_ALPHA + p] = gradient
            for channel in range(d_image.shape[2]):
                gradient = d_image[top + r, left + x, channel] if inside else ZERO
                rest += gradient * image[top + r, left + x, channel] if inside else ZERO
                buffer[D_RGB + channel * PIXELS + p] = gradient
            buffer[REST + p] = rest


def _make_forward(channels: int):
    """The forward kernel for 1 or 3 channels; `rgb` is a constant to the compiler, so unused channels cost nothing."""
    rgb = channels == 3

    @njit(**PARALLEL)
    def forward_kernel(splats, spans, colors, offsets, ids, tiles, image, alpha, scratch):
        height, width = alpha.shape
        tiles_x = (width + TILE - 1) // TILE
        for task in prange(tiles.shape[0]):
            buffer = scratch[get_thread_id()]
            tile = tiles[task]
            top, left = tile // tiles_x * TILE, tile % tiles_x * TILE
            rows, columns = min(TILE, height - top), min(TILE, width - left)
            for r in range(TILE):
                for x in range(TILE):
                    p = r * TILE + x
                    buffer[p] = ONE if r < rows and x < columns else -ONE
                    buffer[X + p], buffer[Y + p] = F(left + x) + HALF, F(top + r) + HALF
            for p in range(RGB, RGB + channels * PIXELS):
                buffer[p] = ZERO
            for k in range(offsets[tile], offsets[tile + 1]):
                i = ids[k]
                x, y, a, b, c, log_opacity = splats[i]
                red = colors[i, 0]
                green, blue = colors[i, 1] if rgb else ZERO, colors[i, 2] if rgb else ZERO
                first, last = max(spans[i, 2] - top, 0), min(spans[i, 3] - top, TILE - 1)
                for p in range(U(first * TILE), U(last * TILE + TILE)):
                    dx, dy = buffer[U(X) + p] - x, buffer[U(Y) + p] - y
                    opacity = _exp2(log_opacity - a * dx * dx - dy * (b * dx + c * dy))
                    weight, behind = _blend(min(opacity, MAX_ALPHA), buffer[p])
                    buffer[p] = behind
                    buffer[U(RGB) + p] += weight * red
                    if rgb:
                        buffer[U(RGB + PIXELS) + p] += weight * green
                        buffer[U(RGB + 2 * PIXELS) + p] += weight * blue
                if (k - offsets[tile]) % CHECK == CHECK - 1 and _is_full(buffer):
                    break
            for r in range(rows):
                for x in range(columns):
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
        splats, spans, colors, offsets, ends, ids, slots, tiles, image, alpha, d_image, d_alpha, pairs, scratch
    ):
        tiles_x = (alpha.shape[1] + TILE - 1) // TILE
        for task in prange(tiles.shape[0]):
            buffer = scratch[get_thread_id()]
            tile = tiles[task]
            top, left = tile // tiles_x * TILE, tile % tiles_x * TILE
            _start_backward(buffer, top, left, image, alpha, d_image, d_alpha)
            full = False
            for k in range(offsets[tile], ends[tile]):
                i, slot = ids[k], slots[k]
                if full:
                    for j in range(6 + channels if slot >= 0 else 0):
                        pairs[slot, j] = ZERO
                    continue
                x, y, a, b, c, log_opacity = splats[i]
                red = colors[i, 0]
                green, blue = colors[i, 1] if rgb else ZERO, colors[i, 2] if rgb else ZERO
                m0 = mx = my = mxx = mxy = myy = d_red = d_green = d_blue = ZERO
                first, last = max(spans[i, 2] - top, 0), min(spans[i, 3] - top, TILE - 1)
                if slot < 0:
                    for p in range(U(first * TILE), U(last * TILE + TILE)):
                        dx, dy = buffer[U(X) + p] - x, buffer[U(Y) + p] - y
                        opacity = _exp2(log_opacity - a * dx * dx - dy * (b * dx + c * dy))
                        weight, behind = _blend(min(opacity, MAX_ALPHA), buffer[p])
                        buffer[p] = behind
                        value = buffer[U(D_ALPHA) + p] + red * buffer[U(D_RGB) + p]
                        if rgb:
                            value += green * buffer[U(D_RGB + PIXELS) + p] + blue * buffer[U(D_RGB + 2 * PIXELS) + p]
                        buffer[U(REST) + p] -= weight * value
                    if (k - offsets[tile]) % CHECK == CHECK - 1:
                        full = _is_full(buffer)
                    continue
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
                pairs[slot, 0], pairs[slot, 1], pairs[slot, 2] = m0, mx, my
                pairs[slot, 3], pairs[slot, 4], pairs[slot, 5] = mxx, mxy, myy
                pairs[slot, 6] = d_red
                if rgb:
                    pairs[slot, 7], pairs[slot, 8] = d_green, d_blue
                if (k - offsets[tile]) % CHECK == CHECK - 1:
                    full = _is_full(buffer)

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
