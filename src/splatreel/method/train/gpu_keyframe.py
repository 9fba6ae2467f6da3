"""Iterations of a keyframe on a GPU."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from splatreel.config import KeyframeConfig
from splatreel.gpu import uniforms
from splatreel.gpu.device import Gpu, Recording
from splatreel.gpu.drawing import Buffers
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.train.density import KeyframeDensity
from splatreel.method.train.gpu_program import GpuProgram, adam_row
from splatreel.method.train.losses import (
    CHAPTER_KEYFRAME,
    KEYFRAME,
    KEYFRAME_BEFORE_STATIC,
    LAMBDA_DSSIM,
    KeyframeStep,
    Loss,
)
from splatreel.method.train.programs import KeyframeDraw, Outcome
from splatreel.method.train.render import StaticCache
from splatreel.method.train.trainable_points import TrainablePoints
from splatreel.method.train.training_images import TrainingImages

LISTS = (KEYFRAME, CHAPTER_KEYFRAME, KEYFRAME_BEFORE_STATIC, KEYFRAME[:1])
"""Lists of losses that the kernels compute."""


def unsupported_keyframe(
    losses: Sequence[Loss[KeyframeStep]], images: TrainingImages, static: StaticCache | None
) -> str | None:
    """Return why the GPU cannot train a keyframe; None if it can."""
    if tuple(losses) not in LISTS:
        return "its losses are not among those that the GPU computes"
    if static is not None and len(losses) > len(CHAPTER_KEYFRAME):
        return "losses of surfaces do not look at static points"
    if any(view.gain is not None for view in images.views):
        return "captures with masks are trained on the CPU or with CUDA"
    return None


class GpuKeyframeProgram(GpuProgram):
    """Program of a keyframe, see `Program`. The losses are those of `LISTS`, fused."""

    def __init__(
        self,
        gpu: Gpu,
        points: TrainablePoints,
        static: StaticCache | None,
        density: KeyframeDensity,
        images: TrainingImages,
        config: KeyframeConfig,
        losses: Sequence[Loss[KeyframeStep]],
        gains: CameraGains,
    ) -> None:
        """Prepare a program.

        Args:
            gpu: Device.
            points: Points of the host.
            static: Static points; None if there are none.
            density: Density control.
            images: Images.
            config: Settings.
            losses: One of `LISTS`.
            gains: Color gains, trained too.
        """
        super().__init__(gpu, points, static, images)
        self._density = density
        self._config = config
        self._losses = losses
        self._gains = gains
        self._shared: Buffers = {}

    def upload(self) -> None:
        """See `Program`."""
        self.upload_points(self.images)
        if self._static is not None:
            alive = self._static.alive.numpy()
            self.upload_static(alive, np.zeros_like(alive))
        adam = self._gains.adam
        size = self.drawing.columns * self.drawing.count
        self._shared = self._stored(
            "keyframe",
            {
                "gains": self._gains.values.numpy(),
                "gain_means": adam.mean.numpy(),
                "gain_squares": adam.square.numpy(),
                "distances": self._density.distances.numpy(),
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
        for name, tensor in (("gains", self._gains.values), ("gain_means", adam.mean), ("gain_squares", adam.square)):
            tensor.copy_(torch.from_numpy(self.gpu.read(self._shared[name], np.float32, shape)))

    def averages(self) -> np.ndarray:
        """Return the running mean of the points' parameters, [columns, N]."""
        return self.gpu.read(self._shared["averages"], np.float32, (self.drawing.columns, self.drawing.count))

    def _prepare(self, draw: KeyframeDraw, steps: list[int], learned: int) -> tuple[np.ndarray, Buffers]:
        """Return the uniform block and the buffers of a draw. steps, learned: numbers of the steps of Adam."""
        block, config = self.block(draw.camera), self._config
        static = self.static_buffers(block, draw.camera, measured=False)
        target = self.target(block, 0, draw.camera)
        self.set_loss(block, LAMBDA_DSSIM)
        weights = {loss.name: loss.weight_at(draw, config) for loss in self._losses}
        width, height = self.drawing.size
        block["loss"][2] = weights.get("opacity", 0.0) / (width * height)
        near = self.images.near
        spread, roughness = weights.get("before surfaces", 0.0), weights.get("bent surfaces", 0.0)
        block["surfaces"] = spread, roughness, near, self.images.unit / near
        block["meters"][0] = draw.average
        flags = uniforms.SCALED_STEPS
        for flag, on in (
            (uniforms.WHOLE, draw.whole),
            (uniforms.METERED, draw.metered),
            (uniforms.ABSOLUTE, config.detail and self._static is None),
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
