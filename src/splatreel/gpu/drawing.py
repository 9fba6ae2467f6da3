"""Drawing on the GPU: projection, sorting into tiles, blending, the photometric loss, and all gradients.

The uniform block of a draw has the fields that `shaders/common.wgsl` declares, in the same order.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from splatreel.gpu.device import Gpu, Recording

VECTORS = ("row0", "row1", "row2", "lens", "bounds", "center", "background", "behind", "loss", "surfaces", "motion")
SHADES = ("shade_rates", "shade_price")
NUMBERS = ("size", "counts", "rows", "numbers", "links")

MOMENTS = 8
"""Moments of a draw: the drawn one, three for smoothness, two for the slope of the time, one unused, the appearance."""
DRAWN, START, END, BETWEEN, BEFORE, AFTER, _, APPEARANCE = range(MOMENTS)

MOVED, SHADED, METERED, METERED_STATIC, WHOLE, FINE, ABSOLUTE, LEARNS_GAINS, SCALED_STEPS, RIGID, TINTED, BOUNDED = (
    1 << bit for bit in range(12)
)
"""Flags of a draw."""

DRAW = np.dtype(
    [(name, np.float32, 4) for name in (*VECTORS, *SHADES)]
    + [(name, np.uint32, 4) for name in NUMBERS]
    + [("meters", np.float32, 4)]
    + [("knots", np.uint32, (MOMENTS, 4)), ("weights", np.float32, (MOMENTS, 4)), ("adam", np.float32, (10, 4))]
)


def new_draw() -> np.ndarray:
    """Return a block [] of zeros."""
    return np.zeros((), DRAW)


def fill_view(
    draw: np.ndarray, viewmat: np.ndarray, K: np.ndarray, width: int, height: int, near: float, antialias: bool
) -> None:
    """Fill the fields of a camera as `kernels.project.Pinhole`. `antialias` blurs splats by 0.1 square pixels instead of 0.3."""
    fx, fy, cx, cy = (float(K[index]) for index in ((0, 0), (1, 1), (0, 2), (1, 2)))
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    draw["row0"], draw["row1"], draw["row2"] = viewmat[:3]
    draw["lens"] = fx, fy, cx, cy
    draw["bounds"][:2] = -cx / fx - margin_x, (width - cx) / fx + margin_x
    draw["bounds"][2:] = -cy / fy - margin_y, (height - cy) / fy + margin_y
    draw["center"][:3] = -viewmat[:3, :3].T @ viewmat[:3, 3]
    draw["center"][3] = near
    draw["background"][3] = 0.1 if antialias else 0.3
    draw["size"] = width, height, -(-width // 16), -(-height // 16)
    draw["numbers"][0] = int(draw["numbers"][0]) & ~FINE | (FINE if antialias else 0)


Buffers = dict[str, Any]
"""Buffers by their names in the kernels."""
SPLAT_BYTES = 48
PARTS = 9
"""Floats in the slot of a (splat, tile) pair."""
BYTES_OF_MAPS = 12
"""Bytes of the maps of SSIM for a pixel and a channel. Where those of three channels exceed a buffer, channels follow one another."""
FEWEST_PAIRS = 4096
"""Pairs that fit at first. The buffers grow when needed."""
SPARE = 1.3
"""Factor by which buffers are larger than needed, so that they rarely grow."""
OPEN = {"DEPTHS": "false"}
"""Constants of kernels that blend colors, not depths."""
DEPTHS = {"DEPTHS": "true"}


class Drawing:
    """Buffers and dispatches to draw points at one image size, in front of static splats, and to compute gradients.

    Attributes:
        capacity: Number of (splat, tile) pairs that fit.
    """

    def __init__(self, gpu: Gpu) -> None:
        self.gpu = gpu
        self.count: int = 0
        self.columns = 14
        self.capacity = 0
        self.size = (0, 0)
        self._channels = 3
        self._static_capacity = -1
        self.buffers: Buffers = {"draw": gpu.uniform(new_draw()), "status": gpu.zeros(8)}
        self._lengths: dict[int, Any] = {}
        self._sums = gpu.zeros(4)
        self.buffers["empty"] = gpu.zeros(32)

    def set_points(self, params: np.ndarray) -> None:
        """Upload points [columns, N] float32: means, quats, log scales, logits, base colors and higher SH bands."""
        gpu, n = self.gpu, params.shape[1]
        buffers = self.buffers
        if params.shape != (self.columns, self.count) or "params" not in buffers:
            self.columns, self.count = params.shape
            gpu.forget_buffers()
            buffers["params"] = gpu.zeros(params.nbytes, "the points")
            buffers["gradients"] = gpu.zeros(params.nbytes, "the gradients of the points")
            buffers["offsets"] = gpu.zeros(4 * 46 * n, "the offsets of the points")
            buffers["d_offsets"] = gpu.zeros(4 * 32 * n, "the gradients of the offsets")
            buffers["splats"] = gpu.zeros(SPLAT_BYTES * n, "the splats")
            buffers["d_splats"] = gpu.zeros(SPLAT_BYTES * n, "the gradients of the splats")
            buffers["first"] = gpu.zeros(4 * (n + 1), "the pairs of the splats")
            buffers["meter"] = gpu.zeros(8 * n, "the meter")
        if params.size:
            gpu.write(buffers["params"], params)

    def set_size(self, width: int, height: int) -> None:
        """Choose the image size, pixels."""
        if self.size == (width, height):
            return
        gpu, buffers, pixels = self.gpu, self.buffers, width * height
        self.size, tiles = (width, height), -(-width // 16) * -(-height // 16)
        self._channels = 3 if BYTES_OF_MAPS * 3 * pixels <= gpu.largest else 1
        gpu.forget_buffers()
        for name, nbytes in (
            ("image", 16 * pixels),
            ("d_image", 16 * pixels),
            ("maps", BYTES_OF_MAPS * self._channels * pixels),
            ("sums", 20 * tiles),
            ("tiles", 16 * tiles),
            ("tile_offsets", 4 * (tiles + 1)),
            ("cursors", 4 * (tiles + 1)),
        ):
            buffers[name] = gpu.zeros(nbytes, f"{name} of {width}x{height} pixels")
        buffers["tile_counts"] = buffers["tile_offsets"]
        buffers["no_offsets"] = gpu.zeros(4 * (tiles + 1))

    def fit_pairs(self, pairs: int, static_pairs: int = 0, measured: bool = False) -> None:
        """Make room for a number of pairs of moving and of static splats. measured: static splats get gradients."""
        slots = static_pairs if measured else 0
        fits = pairs <= self.capacity and self._static_capacity >= static_pairs
        if fits and self.buffers["slots"].size >= 4 * PARTS * (self.capacity + slots):
            return
        self.gpu.forget_buffers()
        if pairs > self.capacity:
            room = (self.gpu.largest - 64) // (
                4 * PARTS
            ) - slots  # of the largest buffer, which is rounded up to 64 bytes
            self.capacity = max(min(max(int(SPARE * pairs), FEWEST_PAIRS), room), pairs)
        self._static_capacity = max(static_pairs, self._static_capacity)
        zeros, buffers = self.gpu.zeros, self.buffers
        buffers["keys"] = zeros(8 * self.capacity, "the pairs of splats and tiles")
        buffers["owners"] = zeros(4 * self.capacity, "the pairs of splats and tiles")
        buffers["list"] = zeros(8 * (self.capacity + self._static_capacity), "the lists of the tiles")
        buffers["slots"] = zeros(4 * PARTS * (self.capacity + slots), "the gradients of the pairs")

    def needed_pairs(self) -> int:
        """Wait, and return the number of pairs that did not fit; 0 if all fit."""
        return int(self.gpu.read(self.buffers["status"], np.uint32, (1,))[0])

    def grow(self, needed: int) -> None:
        """Make room for pairs that did not fit, and let kernels run again."""
        self.fit_pairs(needed)
        self.gpu.write(self.buffers["status"], np.zeros(1, np.uint32))

    def record_pairs(self, to: Recording, buffers: Buffers, count: int | None = None) -> None:
        """Project points, and sort their pairs into tiles. count: number of points; None is all of this drawing."""
        count = self.count if count is None else count
        self.record_counts(to, buffers, count)
        to.run_each(self.gpu.kernel("emit"), max(count, 1), buffers)
        to.run(self.gpu.kernel("sort"), (*self._tiles, 1), buffers)

    def record_counts(self, to: Recording, buffers: Buffers, count: int) -> None:
        """Project points, and compute the range of pairs of every splat and tile."""
        kernel, tiles = self.gpu.kernel, self._tiles[0] * self._tiles[1]
        to.run_each(kernel("reset"), tiles + 1, buffers)
        to.run_each(kernel("project"), count + 1, buffers)
        self.record_scan(to, buffers["first"], count + 1)
        self.record_scan(to, buffers["tile_counts"], tiles + 1)

    def record_scan(self, to: Recording, values: Any, length: int) -> None:
        """Replace the first `length` values of a buffer by the sums of all values before them."""
        gpu = self.gpu
        blocks = -(-length // (4 * gpu.group))
        if length not in self._lengths:
            self._lengths[length] = gpu.uniform(np.array([length, blocks, 0, 0], np.uint32))
        if self._sums.size < 4 * blocks:
            gpu.forget_buffers()
            self._sums = gpu.zeros(4 * blocks, "sums")
        used = {"length": self._lengths[length], "values": values, "sums": self._sums}
        to.run_each(gpu.kernel("scan_blocks"), blocks * gpu.group, used)
        if blocks > 1:
            to.run(gpu.kernel("scan_sums"), (1, 1, 1), used)
            to.run_each(gpu.kernel("scan_add"), length, used)

    def record_image(self, to: Recording, buffers: Buffers) -> None:
        """Merge moving and static splats by depth, and blend them."""
        to.run(self.gpu.kernel("merge"), (*self._tiles, 1), buffers)
        to.run(self.gpu.kernel("forward", **OPEN), (*self._tiles, 1), buffers)

    def record_loss(self, to: Recording, buffers: Buffers) -> None:
        """Compute the photometric loss and its gradient to the image: of all channels, or of one after the other."""
        for first in range(0, 3, self._channels):
            channels = {"FIRST": f"{first}u", "END": f"{first + self._channels}u"}
            to.run(self.gpu.kernel("similarity", **channels), (*self._tiles, 1), buffers)
            to.run(self.gpu.kernel("photometric", **channels), (*self._tiles, 1), buffers)

    def record_splat_gradients(self, to: Recording, buffers: Buffers) -> None:
        """Compute the gradients of the splats from those of the image."""
        to.run(self.gpu.kernel("backward", **OPEN), (*self._tiles, 1), buffers)
        to.run_each(self.gpu.kernel("gather", **OPEN), self.count, buffers)

    def record_surfaces(self, to: Recording, buffers: Buffers) -> None:
        """Add the gradients of the losses of surfaces to those of the splats."""
        kernel, tiles = self.gpu.kernel, (*self._tiles, 1)
        pixels = self.size[0] * self.size[1]
        for name in ("depths", "d_depths"):
            if name not in buffers or buffers[name].size < 16 * pixels:
                buffers[name] = self.buffers[name] = self.gpu.zeros(16 * pixels, "the drawing of depths")
        to.run(kernel("forward", **DEPTHS), tiles, buffers | {"image": buffers["depths"]})
        to.run_each(kernel("surfaces"), pixels, buffers)
        of_depths = {"image": buffers["depths"], "d_image": buffers["d_depths"]}
        to.run(kernel("backward", **DEPTHS), tiles, buffers | of_depths)
        to.run_each(kernel("gather", **DEPTHS), self.count, buffers)

    def record_point_gradients(self, to: Recording, buffers: Buffers) -> None:
        """Compute the gradients of the points and their offsets from those of their splats."""
        to.run_each(self.gpu.kernel("unproject"), self.count, buffers)

    @property
    def _tiles(self) -> tuple[int, int]:
        """Columns and rows of tiles."""
        return -(-self.size[0] // 16), -(-self.size[1] // 16)

    def alone(self) -> Buffers:
        """Return the buffers to draw the points without static splats."""
        none = self.buffers["empty"]
        static = {"static_splats": none, "static_pairs": none, "chosen": none, "frozen": none}
        return self.buffers | static | {"static_offsets": self.buffers["no_offsets"]}


HIDDEN = -100.0
"""Logit of the opacity of points that are no longer static."""
LOGIT = 10
"""Row of the logits among the parameters."""


class StaticScene:
    """Static points, hidden ones included. Each view projects and sorts them once, and draws them alone after each change.

    `pairs` is the largest number of (splat, tile) pairs of a view so far.
    """

    def __init__(self, gpu: Gpu, params: np.ndarray) -> None:
        """Prepare static points. `params` [columns, S] are those of `Drawing.set_points`."""
        self._gpu = gpu
        self._params = params
        self.count = params.shape[1]
        self.pairs = 0
        self._views: dict[int, Buffers] = {}
        self._outdated: set[int] = set()
        self._shown: Any = gpu.zeros(params.nbytes, "the static points")
        self._alive = np.zeros(self.count, bool)
        self._mask: Any = gpu.zeros(4 * self.count)
        self._length = gpu.uniform(np.array([self.count, 0, 0, 0], np.uint32))
        self.chosen: Any = gpu.zeros(4 * self.count)
        self.meter: Any = gpu.zeros(8 * self.count)

    def set_alive(self, alive: np.ndarray, chosen: np.ndarray) -> None:
        """Show only the points of a mask [S]. The gradients of `chosen` points [S] can be measured.

        Views keep their pairs if points are only removed, as density control does.
        """
        if self.count == 0:
            return
        params = self._params.copy()
        params[LOGIT, ~alive] = HIDDEN
        self._gpu.write(self._shown, params)
        self._gpu.write(self.chosen, chosen.astype(np.uint32))
        self._gpu.write(self._mask, alive.astype(np.uint32))
        if np.any(alive & ~self._alive):
            self.forget_views()
        elif np.any(self._alive & ~alive):
            self._outdated = set(self._views)
        self._alive = alive.copy()

    def forget_views(self) -> None:
        """Forget what the views know, such as after a change of the image size."""
        self._views.clear()
        self._outdated.clear()
        self._gpu.forget_buffers()
        self.pairs = 0

    def restart_meter(self) -> None:
        """Set the measured gradients to zero."""
        self._gpu.write(self.meter, np.zeros(2 * self.count, np.float32))

    def view(self, camera: int, draw: np.ndarray, drawing: Drawing) -> Buffers:
        """Return the buffers of a view by the names under which kernels read them. `drawing` has the image size of the view."""
        if camera not in self._views:
            self._views[camera] = self._freeze(draw, drawing)
            self.pairs = max(self.pairs, self._views[camera]["pairs"])
        elif camera in self._outdated:
            self._hide_removed(self._views[camera], drawing)
            self._outdated.discard(camera)
        return self._views[camera]

    def _hide_removed(self, kept: Buffers, drawing: Drawing) -> None:
        """Make points of a view that are no longer alive transparent, and draw the static points again."""
        recording = self._gpu.record()
        used = {"length": self._length, "alive": self._mask, "static_splats": kept["static_splats"]}
        recording.run_each(self._gpu.kernel("hide"), self.count, used)
        drawing.fit_pairs(0, self.pairs)
        alone = drawing.alone() | {name: kept[name] for name in ("static_splats", "static_pairs", "static_offsets")}
        alone |= {"draw": kept["static_draw"], "tile_offsets": drawing.buffers["no_offsets"]}
        drawing.record_image(recording, alone | {"image": kept["frozen"], "status": kept["static_status"]})
        recording.submit()

    def _freeze(self, draw: np.ndarray, drawing: Drawing) -> Buffers:
        gpu, s, (width, height) = self._gpu, self.count, drawing.size
        tiles = -(-width // 16) * -(-height // 16)
        block = draw.copy()
        block["counts"][0], block["counts"][2] = s, 0
        block["numbers"][0] = int(block["numbers"][0]) & ~0x3 | WHOLE  # neither moved nor shaded
        kept: Buffers = {
            "static_splats": gpu.zeros(SPLAT_BYTES * s, "the static splats of a view"),
            "static_first": gpu.zeros(4 * (s + 1), "the static splats of a view"),
            "static_offsets": gpu.zeros(4 * (tiles + 1)),
            "frozen": gpu.zeros(16 * width * height, "the static image of a view"),
            "static_draw": gpu.uniform(block),
            "static_status": gpu.zeros(8),
            "chosen": self.chosen,
        }
        used = drawing.alone() | {
            "draw": kept["static_draw"],
            "params": self._shown,
            "splats": kept["static_splats"],
            "first": kept["static_first"],
            "tile_counts": kept["static_offsets"],
            "tile_offsets": kept["static_offsets"],
            "image": kept["frozen"],
            "status": kept["static_status"],
        }
        counting = gpu.record()
        drawing.record_counts(counting, used, s)
        counting.submit()
        pairs = int(gpu.read(kept["static_first"], np.uint32, (s + 1,))[-1])
        block["counts"][3] = pairs
        gpu.write(kept["static_draw"], block)
        kept["static_pairs"] = gpu.zeros(16 * pairs, "the static pairs of a view")
        used |= {
            "static_pairs": drawing.buffers["empty"],
            "keys": gpu.zeros(8 * pairs, "the static pairs of a view"),
            "owners": gpu.zeros(4 * pairs, "the static pairs of a view"),
            "list": gpu.zeros(8 * pairs, "the static pairs of a view"),
        }
        sorting = gpu.record()
        drawing.record_pairs(sorting, used, s)
        sorting.run_each(gpu.kernel("freeze"), pairs, used | {"static_pairs": kept["static_pairs"]})
        drawing.record_image(sorting, used)
        sorting.submit()
        return kept | {"pairs": pairs}
