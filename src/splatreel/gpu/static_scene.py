"""Static splats on the GPU. Each view projects and sorts them once, and draws them once alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from splatreel.gpu.device import Gpu
from splatreel.gpu.drawing import SPLAT_BYTES, Buffers, Drawing
from splatreel.gpu.uniforms import WHOLE

HIDDEN = -100.0
"""Logit of the opacity of points that are no longer static."""
LOGIT = 10
"""Row of the logits among the parameters."""


class StaticScene:
    """Static points, and what each view knows of them.

    Attributes:
        count: Number of points, hidden ones included.
        pairs: Largest number of (splat, tile) pairs of a view so far.
    """

    def __init__(self, gpu: Gpu, params: np.ndarray) -> None:
        """Prepare static points.

        Args:
            gpu: Device.
            params: [columns, S] float32, as for `Drawing.set_points`.
        """
        self._gpu = gpu
        self._params = params
        self.count = params.shape[1]
        self.pairs = 0
        self._views: dict[int, Buffers] = {}
        self._shown: Any = None
        self.chosen: Any = gpu.zeros(4 * self.count)
        self.meter: Any = gpu.zeros(8 * self.count)

    def set_alive(self, alive: np.ndarray, chosen: np.ndarray) -> None:
        """Show only the points of a mask, and forget the views.

        Args:
            alive: [S] bool.
            chosen: [S] bool, points whose gradients can be measured.
        """
        params = self._params.copy()
        params[LOGIT, ~alive] = HIDDEN
        self._shown = self._gpu.upload(params, "the static points")
        self.chosen = self._gpu.upload(chosen.astype(np.uint32), "the static points")
        self.forget_views()

    def forget_views(self) -> None:
        """Forget what the views know, such as after a change of the image size."""
        self._views.clear()
        self._gpu.forget_buffers()
        self.pairs = 0

    def restart_meter(self) -> None:
        """Set the measured gradients to zero."""
        self._gpu.write(self.meter, np.zeros(2 * self.count, np.float32))

    def view(self, camera: int, draw: np.ndarray, drawing: Drawing) -> Buffers:
        """Return the buffers of a view by the names under which kernels read them.

        Args:
            camera: Number of the view.
            draw: Block of the view: camera, near plane and background.
            drawing: Drawing with the image size of the view.
        """
        if camera not in self._views:
            self._views[camera] = self._freeze(draw, drawing)
            self.pairs = max(self.pairs, self._views[camera]["pairs"])
        return self._views[camera]

    def _freeze(self, draw: np.ndarray, drawing: Drawing) -> Buffers:
        gpu, s, (width, height) = self._gpu, self.count, drawing.size
        tiles = -(-width // 16) * -(-height // 16)
        block = draw.copy()
        block["counts"][0], block["counts"][2] = s, 0
        block["numbers"][0] = int(block["numbers"][0]) & ~0x3 | WHOLE  # neither moved nor shaded
        uniform = gpu.uniform(block)
        kept: Buffers = {
            "static_splats": gpu.zeros(SPLAT_BYTES * s, "the static splats of a view"),
            "static_first": gpu.zeros(4 * (s + 1), "the static splats of a view"),
            "static_offsets": gpu.zeros(4 * (tiles + 1)),
            "frozen": gpu.zeros(16 * width * height, "the static image of a view"),
            "chosen": self.chosen,
        }
        used = drawing.alone() | {
            "draw": uniform,
            "params": self._shown,
            "splats": kept["static_splats"],
            "first": kept["static_first"],
            "tile_counts": kept["static_offsets"],
            "tile_offsets": kept["static_offsets"],
            "image": kept["frozen"],
            "status": gpu.zeros(8),
        }
        counting = gpu.record()
        drawing.record_counts(counting, used, s)
        counting.submit()
        pairs = int(gpu.read(kept["static_first"], np.uint32, (s + 1,))[-1])
        block["counts"][3] = pairs
        gpu.write(uniform, block)
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
