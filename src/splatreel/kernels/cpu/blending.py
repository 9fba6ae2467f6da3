"""The kernels of the rasterizer: front-to-back alpha blending of one tile after the other, and its gradient.

One task renders one 16 x 16 tile in a small scratch that stays in the first-level cache: planes of 256 floats, one a
quantity, at constant offsets, so that LLVM can prove the planes independent and turn the loop over a splat's rows of
pixels into vector code. That is worth a factor of ten, and easily lost: keep the index unsigned (`U`), the offsets
constant, one flat loop, and no reduction but sums. A test looks for the vector registers in the machine code.

Transmittance is kept per pixel; its sign says whether the pixel still takes light: it turns negative once the next
splat would leave 1e-4 or less, as in gsplat.
"""

from __future__ import annotations

from numba import get_thread_id, njit, prange  # pyright: ignore[reportPrivateImportUsage]

from splatreel.kernels.cpu.binning import DEPTH, MIN_ALPHA, TILE
from splatreel.kernels.cpu.jit import HALF, ONE, PARALLEL, ZERO, F, U

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


# Scratch planes. Both passes: transmittance, pixel center x and y. Forward: then the color accumulated.
X, Y, RGB = PIXELS, 2 * PIXELS, 3 * PIXELS
# Backward: then the remainder (what splats behind contribute to the loss), gradient to alpha, gradient to color.
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
    """Fills a tile's pixel centers and transmittance; pixels outside the image or the rows first..last are full."""
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
    def forward_kernel(moving, held, some, tiles, image, alpha, scratch):
        splats, colors, offsets, ids, rows = moving
        h_splats, h_colors, h_offsets, h_ids, h_rows = held
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


@njit(inline="always")
def _shade(buffer, first, last, x, y, a, b, c, log_opacity, red, green, blue, rgb):
    """A frozen splat of the backward pass: only takes light away from what is behind it."""
    for p in range(U(first * TILE), U(max(last + 1, first) * TILE)):
        dx, dy = buffer[U(X) + p] - x, buffer[U(Y) + p] - y
        opacity = _exp2(log_opacity - a * dx * dx - dy * (b * dx + c * dy))
        weight, behind = _blend(min(opacity, MAX_ALPHA), buffer[p])
        buffer[p] = behind
        value = buffer[U(D_ALPHA) + p] + red * buffer[U(D_RGB) + p]
        if rgb:
            value += green * buffer[U(D_RGB + PIXELS) + p] + blue * buffer[U(D_RGB + 2 * PIXELS) + p]
        buffer[U(REST) + p] -= weight * value


def _make_backward(channels: int):
    """The backward kernel for 1 or 3 channels, front to back as the forward one.

    `rest` starts as the gradient-weighted color and alpha of the pixel and loses each splat's share in turn, so that
    what remains belongs to the splats behind: no transmittance need be stored or divided back. Six moments of
    d(log alpha) over the pixels are all that mean, conic and opacity gradients need.
    """
    rgb = channels == 3

    @njit(**PARALLEL)
    def backward_kernel(moving, slots, held, some, tiles, image, alpha, d_image, d_alpha, pairs, scratch):
        splats, colors, offsets, ids, rows = moving
        h_splats, h_colors, h_offsets, h_ids, h_rows = held
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
                    _shade(buffer, first, last, x, y, a, b, c, log_opacity, red, green, blue, rgb)
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
                pairs[slot, 0], pairs[slot, 1], pairs[slot, 2], pairs[slot, 3] = m0, mx, my, mxx
                pairs[slot, 4], pairs[slot, 5], pairs[slot, 6] = mxy, myy, d_red
                if rgb:
                    pairs[slot, 7], pairs[slot, 8] = d_green, d_blue
                k += 1
            for hidden in range(k, end):
                for j in range(6 + channels):
                    pairs[slots[hidden], j] = ZERO

    return backward_kernel


forward_1, forward_3 = _make_forward(1), _make_forward(3)
backward_1, backward_3 = _make_backward(1), _make_backward(3)
