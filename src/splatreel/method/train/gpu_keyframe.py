"""Iterations of a keyframe on a GPU."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splatreel.gpu import uniforms
from splatreel.gpu.device import Gpu, Recording
from splatreel.gpu.drawing import Buffers
from splatreel.method.train.gpu_program import GpuProgram, OwnPrograms, adam_row, put_columns
from splatreel.method.train.losses import LAMBDA_DSSIM, weight_of
from splatreel.method.train.programs import KeyframeDraw, KeyframeProgram, KeyframeState, Outcome
from splatreel.method.train.terms.opacity import Opacity
from splatreel.method.train.terms.surfaces import Roughness, Spread


def keyframe_program(opened: Gpu | OwnPrograms, state: KeyframeState) -> KeyframeProgram:
    """Return the program of a keyframe on an opened GPU."""
    return GpuKeyframeProgram(opened, state) if isinstance(opened, Gpu) else opened.keyframe_program(state)


class GpuKeyframeProgram(GpuProgram):
    """Program of a keyframe, see `KeyframeProgram`. The losses are fused."""

    def __init__(self, gpu: Gpu, state: KeyframeState) -> None:
        """Prepare a program; `upload` follows."""
        super().__init__(gpu, state.points, state.static, state.images)
        self._state = state
        self._density = state.density
        self._losses = state.losses
        self._gains = state.gains
        self._shared: Buffers = {}

    def upload(self) -> None:
        """See `Program`."""
        self.upload_points(self.images)
        if self._static is not None:
            alive = self._static.alive
            self.upload_static(alive, np.zeros_like(alive))
        adam = self._gains.adam
        size = self.drawing.columns * self.drawing.count
        self._shared = self._stored(
            "keyframe",
            {
                "gains": self._gains.values,
                "gain_means": adam.mean,
                "gain_squares": adam.square,
                "distances": self._density.distances,
                "slopes": np.zeros(1, np.float32),
                "averages": np.zeros(size, np.float32),
            },
        )

    def run(self, draws: Sequence[KeyframeDraw]) -> list[Outcome]:
        """See `Program`."""
        adams, gains = list(self._points.adams.values()), self._gains
        steps, learned = [adam.steps for adam in adams], gains.adam.steps
        learns = np.cumsum([gains.enabled and draw.whole for draw in draws])

        def prepare(k: int) -> tuple[np.ndarray, Buffers]:
            return self._prepare(draws[k], [step + k + 1 for step in steps], learned + int(learns[k]))

        found = self.run_batch(len(draws), prepare, self._record)
        for adam in adams:
            adam.steps += len(draws)
        gains.adam.steps += int(learns[-1])
        return found

    def give_meters(self) -> None:
        """See `Program`."""
        self._density.meter.sum, self._density.meter.seen = self.read_meter()

    def download(self) -> None:
        """See `Program`."""
        self.download_points()
        shape = len(self.images.views), 3
        adam = self._gains.adam
        for name, array in (("gains", self._gains.values), ("gain_means", adam.mean), ("gain_squares", adam.square)):
            array[...] = self.gpu.read(self._shared[name], np.float32, shape)

    def averages(self) -> list[np.ndarray]:
        """See `KeyframeProgram`."""
        means = [np.empty_like(array) for array in self._points.params.values()]
        shape = self.drawing.columns, self.drawing.count
        put_columns(self.gpu.read(self._shared["averages"], np.float32, shape), means)
        return means

    def _prepare(self, draw: KeyframeDraw, steps: list[int], learned: int) -> tuple[np.ndarray, Buffers]:
        """Return the uniform block and the buffers of a draw. steps, learned: numbers of the steps of Adam."""
        block = self.block(draw.camera)
        static = self.static_buffers(block, draw.camera, measured=False)
        target = self.target(block, 0, draw.camera)
        self.set_loss(block, LAMBDA_DSSIM)
        kinds = Opacity, Spread, Roughness
        faint, before, bent = (weight_of(kind, self._losses, draw, self._state.config) for kind in kinds)
        width, height = self.drawing.size
        block["loss"][2] = faint / (width * height)
        near = self.images.near
        block["surfaces"] = before, bent, near, self.images.unit / near
        block["meters"][0] = draw.average
        flags = uniforms.SCALED_STEPS
        for flag, on in (
            (uniforms.WHOLE, draw.whole),
            (uniforms.METERED, draw.metered),
            (uniforms.ABSOLUTE, self._state.measures_absolute),
            (uniforms.LEARNS_GAINS, draw.whole and self._gains.enabled),
        ):
            flags |= flag if on else 0
        block["numbers"][0] |= flags
        for k, adam in enumerate(self._points.adams.values()):
            block["adam"][k] = adam_row(draw.rates[k], steps[k], adam.eps)
        block["adam"][9] = adam_row(self._gains.adam.rate, max(learned, 1), self._gains.adam.eps)
        return block, static | self._shared | {"targets": target}

    def _record(self, to: Recording, block: np.ndarray, buffers: Buffers) -> None:
        """Record the dispatches of a draw."""
        drawing, kernel = self.drawing, self.gpu.kernel
        drawing.record_pairs(to, buffers)
        drawing.record_image(to, buffers)
        drawing.record_loss(to, buffers)
        drawing.record_splat_gradients(to, buffers)
        if block["surfaces"][0] or block["surfaces"][1]:
            drawing.record_surfaces(to, buffers)
        drawing.record_point_gradients(to, buffers)
        to.run_each(kernel("adam_points"), drawing.count * drawing.columns, buffers | self._moments)
        gains = {"means": buffers["gain_means"], "squares": buffers["gain_squares"]}
        to.run(kernel("finish"), (1, 1, 1), buffers | gains)
