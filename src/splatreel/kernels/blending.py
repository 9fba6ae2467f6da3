"""Front-to-back alpha blending of 16 x 16 tiles, one after another, and its gradient.

The pixels of a tile are in a small buffer that stays in the first-level cache. For each row of pixels, the buffer has one row of floats
per quantity. `rows` turns arithmetic on these rows into vector code.

A pixel is open while its transmittance is positive. The transmittance becomes negative, and the pixel full, once the next splat would
leave 1e-4 or less, as in gsplat.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils

from splatreel.base.jit import BOOL, F2, F3, I1, L1, U2, range_kernel
from splatreel.kernels.binning import DEPTH, MIN_ALPHA, STRIP, TILE
from splatreel.kernels.rows import Memory, Row, Sums, counted, prefetch, row_loop, spread, stack_floats
from splatreel.kernels.scalars import HALF, ONE, ZERO, F, U

MAX_ALPHA = F(0.999)
MIN_TRANSMITTANCE = F(1e-4)
CHANNELS = 3
PARTS = 6 + CHANNELS
"""Floats in the gradient of a (splat, tile) pair: moments, and the gradient to the color."""
CHECK = 16
"""Number of splats between two checks whether all pixels of the tile are full."""
AHEAD = 6
"""Number of splats to prefetch: in depth order, they are scattered over memory."""

GATHERED = 12
"""Channels that one pass of `gather` sums up."""

# Coefficients of 2^(e/8) for e in -8..0. The eighth power is 2^e to 1.5e-6. LLVM has no vector exp without a library.
POWERS = (
    4.1371553405333827e-10,
    3.884498056550001e-08,
    2.338086460440536e-06,
    0.00010837755689863116,
    0.0037534991279244423,
    0.08664337545633316,
    1.0,
)
MIN_EXPONENT = -8.0  # below 1/255, so such alphas are dropped anyway

# Rows of floats for each row of pixels. Forward pass: transmittance and blended color.
TRANSMITTANCE, RGB, FORWARD_ROWS = 0, 1, 4
# Backward pass: transmittance, remainder (contribution of the splats behind to the loss), gradient to alpha, gradient to color.
REST, D_ALPHA, D_RGB, BACKWARD_ROWS = 1, 2, 3, 6

# Sums of images: transmittance and the channels of the images.
CHANNEL, GATHER_ROWS = 1, 1 + GATHERED

FORWARD_FLOATS, BACKWARD_FLOATS = FORWARD_ROWS * TILE * TILE, BACKWARD_ROWS * TILE * TILE
GATHER_FLOATS = GATHER_ROWS * TILE * TILE

DRAWN = types.Tuple((F2, F2, I1, I1, U2))
"""Type of `rasterize.Drawn`."""


def _alpha(builder: Any, dx: Row, dy: Any, splat: Sequence[Any]) -> Row:
    """Build the opacity of a splat in a row of pixels. dx: pixels from its center. dy: LLVM float, pixels from its center."""
    a, b, c, log_opacity = splat
    fast = {"flags": ("fast",)}
    base = builder.fsub(log_opacity, builder.fmul(builder.fmul(c, dy, **fast), dy, **fast), **fast)
    tilt = builder.fmul(b, dy, **fast)
    exponent = (spread(builder, base, dx.width) - dx * (dx * a + tilt)).at_least(MIN_EXPONENT)
    power = exponent * POWERS[0] + POWERS[1]
    for coefficient in POWERS[2:]:
        power = power * exponent + coefficient
    power = power * power
    power = power * power
    return power * power


def _weigh(opacity: Row, transmittance: Row) -> tuple[Row, Row, Row]:
    """Build a splat's clamped alpha, its weight, and the transmittance behind it, which is negative if the pixel is full.

    The transmittance of a full pixel stays negative.
    """
    clamped = opacity.at_most(float(MAX_ALPHA))
    weight = (clamped >= float(MIN_ALPHA)).where(clamped, 0.0) * transmittance
    behind = transmittance - weight
    is_open = behind > float(MIN_TRANSMITTANCE)
    return clamped, is_open.where(weight, 0.0), is_open.where(behind, transmittance.negative())


class _Rows:
    """Builder of the loop over a splat's rows of pixels. splat: LLVM floats x, y, a, b, c, log opacity."""

    def __init__(self, builder: Any, memory: Memory, planes: int, splat: Sequence[Any]) -> None:
        self.builder = builder
        self.memory = memory
        self.planes = planes
        self.x, self.y, *self.shape = splat

    def each(self, rows: Sequence[Any], work: Any) -> None:
        """Build `work(start, transmittance, dx, dy, opacity)` for all rows of pixels, in parts that fill a register.

        The loop skips parts without an open pixel.

        Args:
            rows: First and last row in the left half of the tile, and in the right half. A register that holds both uses their union.
            work: Builder of the loop's body.
        """
        first, last, other_first, other_last = rows
        if self.memory.width == STRIP:
            self._part(0, first, last, work)
            self._part(STRIP, other_first, other_last, work)
        else:
            self._part(0, self._pick("<", first, other_first), self._pick(">", last, other_last), work)

    def _pick(self, comparison: str, one: Any, other: Any) -> Any:
        """Build the smaller or larger of two integers."""
        return self.builder.select(self.builder.icmp_signed(comparison, one, other), one, other)

    def _part(self, column: int, first: Any, last: Any, work: Any) -> None:
        """Build the loop over rows first..last of the pixels from `column` on that fill a register."""
        builder, one = self.builder, ir.Constant(first.type, 1)
        dx = counted(builder, column, self.memory.width) - self.x
        with cgutils.for_range_slice(builder, first, builder.add(last, one), one) as (row, _):
            dy = builder.fsub(builder.sitofp(row, ir.FloatType()), self.y, flags=("fast",))
            start = builder.mul(row, ir.Constant(row.type, self.planes * TILE))
            start = builder.add(start, ir.Constant(row.type, column))
            transmittance = self.memory.load(start, TRANSMITTANCE * TILE)
            with builder.if_then((transmittance > 0.0).any()):
                work(start, transmittance, dx, dy, _alpha(builder, dx, dy, self.shape))


@row_loop(integers=4, floats=9)
def _blend(builder: Any, memory: Memory, *values: Any) -> None:
    """Blend a splat into a tile. values: rows as in `_Rows.each`, x, y, conic, log opacity and color."""
    rows, splat, color = values[:4], values[4:10], values[10:]

    def work(start: Any, transmittance: Row, dx: Row, dy: Any, opacity: Row) -> None:
        _, weight, behind = _weigh(opacity, transmittance)
        memory.store(start, TRANSMITTANCE * TILE, behind)
        for channel, value in enumerate(color):
            memory.store(start, (RGB + channel) * TILE, memory.load(start, (RGB + channel) * TILE) + weight * value)

    _Rows(builder, memory, FORWARD_ROWS, splat).each(rows, work)


def _value(memory: Memory, start: Any, color: Sequence[Any]) -> Row:
    """Build the gradient of the loss to the weight of a splat in a row of pixels."""
    value = memory.load(start, D_ALPHA * TILE)
    for channel, part in enumerate(color):
        value = value + memory.load(start, (D_RGB + channel) * TILE) * part
    return value


@row_loop(integers=4, floats=9)
def _shade(builder: Any, memory: Memory, *values: Any) -> None:
    """Account for a frozen splat in the backward pass: update transmittance and remainder. values: see `_blend`."""
    rows, splat, color = values[:4], values[4:10], values[10:]

    def work(start: Any, transmittance: Row, dx: Row, dy: Any, opacity: Row) -> None:
        _, weight, behind = _weigh(opacity, transmittance)
        memory.store(start, TRANSMITTANCE * TILE, behind)
        memory.store(start, REST * TILE, memory.load(start, REST * TILE) - weight * _value(memory, start, color))

    _Rows(builder, memory, BACKWARD_ROWS, splat).each(rows, work)


@row_loop(integers=4, floats=9, results=PARTS)
def _gradient(builder: Any, memory: Memory, *values: Any) -> list[Any]:
    """Return six moments of d(log alpha) over the pixels of a splat, and the gradient to its color.

    The moments are those of 1, dx, dy, dx^2, dx dy and dy^2. The gradients to mean, conic and opacity follow from them.
    values: see `_blend`.
    """
    rows, splat, color = values[:4], values[4:10], values[10:]
    sums = Sums(builder, PARTS, memory.width)

    def work(start: Any, transmittance: Row, dx: Row, dy: Any, opacity: Row) -> None:
        clamped, weight, behind = _weigh(opacity, transmittance)
        memory.store(start, TRANSMITTANCE * TILE, behind)
        value = _value(memory, start, color)
        rest = memory.load(start, REST * TILE) - weight * value
        memory.store(start, REST * TILE, rest)
        d_clamped = transmittance * value - rest / (clamped * -1.0 + 1.0)
        is_drawn = (opacity <= float(MAX_ALPHA)) & (weight > 0.0)  # no gradient through the clamp
        moment = is_drawn.where(opacity * d_clamped, 0.0)
        across, down = moment * dx, moment * dy
        colors = [weight * memory.load(start, (D_RGB + channel) * TILE) for channel in range(CHANNELS)]
        sums.add([moment, across, down, across * dx, down * dx, down * dy, *colors])

    _Rows(builder, memory, BACKWARD_ROWS, splat).each(rows, work)
    return sums.totals()


@row_loop(integers=4, floats=6, results=GATHERED)
def _collect(builder: Any, memory: Memory, *values: Any) -> list[Any]:
    """Return the sums of images over the pixels of a splat, weighted by its share. values: see `_blend`, without a color."""
    rows, splat = values[:4], values[4:]
    sums = Sums(builder, GATHERED, memory.width)

    def work(start: Any, transmittance: Row, dx: Row, dy: Any, opacity: Row) -> None:
        _, weight, behind = _weigh(opacity, transmittance)
        memory.store(start, TRANSMITTANCE * TILE, behind)
        sums.add([weight * memory.load(start, (CHANNEL + channel) * TILE) for channel in range(GATHERED)])

    _Rows(builder, memory, GATHER_ROWS, splat).each(rows, work)
    return sums.totals()


@row_loop(integers=1, results=1)
def _open(builder: Any, memory: Memory, stride: Any) -> list[Any]:
    """Return 1 if a pixel of a tile is open, else 0. stride: floats from one row of pixels to the next."""
    zero, one, rows = (ir.Constant(stride.type, number) for number in (0, 1, TILE))
    found = cgutils.alloca_once_value(builder, ir.Constant(ir.FloatType(), 0.0))
    builder.store(ir.Constant(ir.FloatType(), 0.0), found)
    with cgutils.for_range_slice(builder, zero, rows, one) as (row, _):
        for column in range(0, TILE, memory.width):
            transmittance = memory.load(builder.mul(row, stride), TRANSMITTANCE * TILE + column)
            with builder.if_then((transmittance > 0.0).any()):
                builder.store(ir.Constant(ir.FloatType(), 1.0), found)
    return [builder.load(found)]


@njit(inline="always")
def _extent(rows, start, end, some):
    """Return the first and last row of a tile to draw: all rows, or, if `some`, those that its splats cover."""
    if not some:
        return 0, TILE - 1
    first, last = TILE - 1, 0
    for k in range(start, end):
        for half in range(2):
            first, last = min(first, rows[k, half] // TILE), max(last, rows[k, half] % TILE)
    return first, last


@njit(inline="always")
def _limits(rows, k, highest, lowest):
    """Return the first and last row of pair k in the left half of its tile and in the right half, within highest..lowest."""
    first, last = max(rows[k, 0] // TILE, highest), min(rows[k, 0] % TILE, lowest)
    return first, last, max(rows[k, 1] // TILE, highest), min(rows[k, 1] % TILE, lowest)


@njit(inline="always")
def _start(buffer, planes, top, left, first, last, shape):
    """Fill a tile's transmittance. Pixels outside the image or outside rows first..last are full."""
    for r in range(TILE):
        columns = min(TILE, shape[1] - left) if first <= r <= last and top + r < shape[0] else 0
        row = buffer[r * planes * TILE : r * planes * TILE + TILE]
        row[:] = -ONE
        row[:columns] = ONE


@njit(inline="always")
def _start_gradient(buffer, top, left, image, alpha, d_image, d_alpha):
    """Fill a tile's rows of gradients. Pixels outside the image have zeros."""
    for r in range(TILE):
        start = r * BACKWARD_ROWS * TILE
        for x in range(TILE):
            inside = top + r < alpha.shape[0] and left + x < alpha.shape[1]
            gradient = d_alpha[top + r, left + x] if inside else ZERO
            rest = gradient * alpha[top + r, left + x] if inside else ZERO
            buffer[start + D_ALPHA * TILE + x] = gradient
            for channel in range(CHANNELS):
                gradient = d_image[top + r, left + x, channel] if inside else ZERO
                rest += gradient * image[top + r, left + x, channel] if inside else ZERO
                buffer[start + (D_RGB + channel) * TILE + x] = gradient
            buffer[start + REST * TILE + x] = rest


@njit(inline="always")
def _place(splats, i, across, down):
    """Return the center within the tile, the conic and the log opacity of a splat."""
    x, y = splats[i, 0] - across, splats[i, 1] - down
    return x, y, splats[i, 2], splats[i, 3], splats[i, 4], splats[i, 5]


@njit(inline="always")
def _read(splats, colors, i, across, down):
    """Return the center within the tile, the conic, the log opacity and the color of a splat."""
    x, y, a, b, c, log_opacity = _place(splats, i, across, down)
    return x, y, a, b, c, log_opacity, colors[i, 0], colors[i, 1], colors[i, 2]


@njit(inline="always")
def _fetch(splats, colors, ids, k, end):
    """Prefetch the splat that is blended AHEAD splats after splat k."""
    if k + AHEAD < end:
        prefetch(splats, ids[k + AHEAD])
        prefetch(colors, ids[k + AHEAD])


@range_kernel(L1, DRAWN, DRAWN, BOOL, F3, F2)
def forward(first_task, last_task, tiles, moving, held, some, image, alpha):
    """Blend the splats of tiles, merging the lists of moving and frozen splats by depth. Names of frozen splats begin with h (held)."""
    splats, colors, offsets, ids, rows = moving
    h_splats, h_colors, h_offsets, h_ids, h_rows = held
    tiles_x = (alpha.shape[1] + TILE - 1) // TILE
    buffer = stack_floats(FORWARD_FLOATS)
    for task in range(first_task, last_task):
        tile = tiles[task]
        top, left = tile // tiles_x * TILE, tile % tiles_x * TILE
        across, down = F(left) + HALF, F(top) + HALF
        k, end, h, h_end = offsets[tile], offsets[tile + 1], h_offsets[tile], h_offsets[tile + 1]
        highest, lowest = _extent(rows, k, end, some)
        buffer[:] = ZERO
        _start(buffer, FORWARD_ROWS, top, left, highest, lowest, alpha.shape)
        while k < end or h < h_end:
            if h < h_end and (k == end or h_splats[U(h_ids[h]), DEPTH] < splats[U(ids[k]), DEPTH]):
                _fetch(h_splats, h_colors, h_ids, h, h_end)
                i, limits = U(h_ids[h]), _limits(h_rows, h, highest, lowest)
                x, y, a, b, c, log_opacity, red, green, blue = _read(h_splats, h_colors, i, across, down)
                h += 1
            else:
                _fetch(splats, colors, ids, k, end)
                i, limits = U(ids[k]), _limits(rows, k, highest, lowest)
                x, y, a, b, c, log_opacity, red, green, blue = _read(splats, colors, i, across, down)
                k += 1
            _blend(buffer, *limits, x, y, a, b, c, log_opacity, red, green, blue)
            if (k + h) % CHECK == 0 and _open(buffer, FORWARD_ROWS * TILE)[0] == ZERO:
                break
        for r in range(highest, min(lowest + 1, alpha.shape[0] - top)):
            start = r * FORWARD_ROWS * TILE
            for x in range(min(TILE, alpha.shape[1] - left)):
                alpha[top + r, left + x] = ONE - abs(buffer[start + x])
                for channel in range(CHANNELS):
                    image[top + r, left + x, channel] = buffer[start + (RGB + channel) * TILE + x]


@range_kernel(L1, DRAWN, I1, DRAWN, BOOL, F3, F2, F3, F2, F2)
def backward(first_task, last_task, tiles, moving, slots, held, some, image, alpha, d_image, d_alpha, pairs):
    """Write the moments and color gradients of each (splat, tile) pair into its slot of pairs [M, 9].

    Splats are visited front to back, as in `forward`. The remainder starts as the gradient-weighted color and alpha of the pixel. Each
    splat subtracts its contribution, so that the remainder belongs to the splats behind it. No transmittance is stored or divided back.
    """
    splats, colors, offsets, ids, rows = moving
    h_splats, h_colors, h_offsets, h_ids, h_rows = held
    tiles_x = (alpha.shape[1] + TILE - 1) // TILE
    buffer = stack_floats(BACKWARD_FLOATS)
    for task in range(first_task, last_task):
        tile = tiles[task]
        top, left = tile // tiles_x * TILE, tile % tiles_x * TILE
        across, down = F(left) + HALF, F(top) + HALF
        k, end, h, h_end = offsets[tile], offsets[tile + 1], h_offsets[tile], h_offsets[tile + 1]
        highest, lowest = _extent(rows, k, end, some)
        _start(buffer, BACKWARD_ROWS, top, left, highest, lowest, alpha.shape)
        _start_gradient(buffer, top, left, image, alpha, d_image, d_alpha)
        while k < end:
            if (k + h) % CHECK == 0 and _open(buffer, BACKWARD_ROWS * TILE)[0] == ZERO:
                break
            if h < h_end and h_splats[U(h_ids[h]), DEPTH] < splats[U(ids[k]), DEPTH]:
                _fetch(h_splats, h_colors, h_ids, h, h_end)
                i, limits = U(h_ids[h]), _limits(h_rows, h, highest, lowest)
                x, y, a, b, c, log_opacity, red, green, blue = _read(h_splats, h_colors, i, across, down)
                _shade(buffer, *limits, x, y, a, b, c, log_opacity, red, green, blue)
                h += 1
                continue
            _fetch(splats, colors, ids, k, end)
            i, limits = U(ids[k]), _limits(rows, k, 0, TILE - 1)
            x, y, a, b, c, log_opacity, red, green, blue = _read(splats, colors, i, across, down)
            found = _gradient(buffer, *limits, x, y, a, b, c, log_opacity, red, green, blue)
            slot = slots[k]
            for part in range(PARTS):
                pairs[slot, part] = found[part]
            k += 1
        for hidden in range(k, end):
            for part in range(PARTS):
                pairs[slots[hidden], part] = ZERO


@range_kernel(L1, F2, I1, I1, U2, I1, F3, F2)
def gather(first_task, last_task, tiles, splats, offsets, ids, rows, slots, images, pairs):
    """Write the weighted sums of images [H, W, 12] over each (splat, tile) pair into its slot of pairs [M, 12]."""
    height, width = images.shape[0], images.shape[1]
    tiles_x = (width + TILE - 1) // TILE
    buffer = stack_floats(GATHER_FLOATS)
    for task in range(first_task, last_task):
        tile = tiles[task]
        top, left = tile // tiles_x * TILE, tile % tiles_x * TILE
        across, down = F(left) + HALF, F(top) + HALF
        k, end = offsets[tile], offsets[tile + 1]
        buffer[:] = ZERO
        _start(buffer, GATHER_ROWS, top, left, 0, TILE - 1, (height, width))
        for r in range(min(TILE, height - top)):
            for x in range(min(TILE, width - left)):
                for channel in range(GATHERED):
                    buffer[(r * GATHER_ROWS + CHANNEL + channel) * TILE + x] = images[top + r, left + x, channel]
        while k < end:
            if k % CHECK == 0 and _open(buffer, GATHER_ROWS * TILE)[0] == ZERO:
                break
            if k + AHEAD < end:
                prefetch(splats, ids[k + AHEAD])
            x, y, a, b, c, log_opacity = _place(splats, U(ids[k]), across, down)
            found = _collect(buffer, *_limits(rows, k, 0, TILE - 1), x, y, a, b, c, log_opacity)
            for channel in range(GATHERED):
                pairs[slots[k], channel] = found[channel]
            k += 1
        for hidden in range(k, end):
            for channel in range(GATHERED):
                pairs[slots[hidden], channel] = ZERO
