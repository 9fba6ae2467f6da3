"""Parts that the GPU programs of groups and keyframes share: points and images on the device, and batches of draws."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.gpu import uniforms
from splatreel.gpu.device import Gpu, Recording
from splatreel.gpu.drawing import Buffers, Drawing
from splatreel.gpu.image_pool import ImagePool
from splatreel.gpu.static_scene import StaticScene
from splatreel.method.deform.knot_adam import DECAYS
from splatreel.method.train.programs import MOST_DRAWS, GroupState, KeyframeState, Outcome
from splatreel.method.train.render import StaticCache
from splatreel.method.train.trainable_points import NAMES, TrainablePoints
from splatreel.method.train.training_images import TrainingImages

FIRST_PAIRS = 8
"""Pairs per point that fit at first."""


class OwnPrograms(Protocol):
    """An opened GPU with programs of its own, such as `gsplat.device.GsplatGpu`."""

    def unsupported(self, state: GroupState | KeyframeState) -> str | None:
        """Return why the GPU cannot train a state; None if it can."""
        ...

    def group_program(self, state: GroupState) -> Any:
        """Return the `Program` of a group."""
        ...

    def keyframe_program(self, state: KeyframeState) -> Any:
        """Return the `KeyframeProgram` of a keyframe."""
        ...


def unsupported(opened: Gpu | OwnPrograms, state: GroupState | KeyframeState) -> str | None:
    """Return why an opened GPU cannot train a state, so that the CPU does; None if it can."""
    return state.unsupported_by_gpu if isinstance(opened, Gpu) else opened.unsupported(state)


class GpuProgram:
    """Points, static points and images on a GPU.

    Attributes:
        gpu: Device.
        images: Images in use.
        drawing: Buffers and dispatches of the drawing.
    """

    def __init__(self, gpu: Gpu, points: TrainablePoints, static: StaticCache | None, images: TrainingImages) -> None:
        """Prepare a program; `upload` follows.

        Args:
            gpu: Device.
            points: Canonical points of the host.
            static: Static points; None if there are none.
            images: Images.
        """
        self.gpu = gpu
        self.images = images
        self._points = points
        self._static = static
        self.drawing = Drawing(gpu)
        self._results = gpu.zeros(16 * MOST_DRAWS)
        self._scene: StaticScene | None = None
        self._moments: Buffers = {}
        self._pool: ImagePool | None = None
        self._adam_buffers: dict[str, Buffers] = {}
        self._packed: dict[tuple[int, int], int] = {}

    def upload_points(self, images: TrainingImages) -> None:
        """Copy the canonical points and their moments to the device, and choose the image size."""
        gpu, adams = self.gpu, list(self._points.adams.values())
        width, height = images.views[0].width, images.views[0].height
        if self._pool is None or self.drawing.size != (width, height) or images is not self.images:
            self.images = images
            self._pool = ImagePool(gpu, width, height, images.count * len(images.all_views))
            if self._scene is not None:
                self._scene.forget_views()
        self.drawing.set_points(_columns([adam.parameter for adam in adams]))
        self.drawing.set_size(width, height)
        self.drawing.fit_pairs(FIRST_PAIRS * self.drawing.count)
        moments = {
            "means": _columns([adam.mean for adam in adams]),
            "squares": _columns([adam.square for adam in adams]),
        }
        self._moments = self._stored("points", moments)
        gpu.write(self.drawing.buffers["meter"], np.zeros(2 * self.drawing.count, np.float32))

    def upload_static(self, alive: np.ndarray, chosen: np.ndarray) -> None:
        """Copy the static points to the device, if they changed. alive, chosen: see `StaticScene.set_alive`."""
        if self._static is None:
            return
        if self._scene is None:
            params = _columns([self._static.params[name] for name in NAMES])
            self._scene = StaticScene(self.gpu, params)
            self._shown: tuple[bytes, bytes] | None = None
        now = alive.tobytes(), chosen.tobytes()
        if now != self._shown:
            self._scene.set_alive(alive, chosen)
            self._shown = now
        self._scene.restart_meter()

    def download_points(self) -> None:
        """Copy the canonical points and their moments to the host."""
        shape = self.drawing.columns, self.drawing.count
        for buffer, arrays in (
            (self.drawing.buffers["params"], [adam.parameter for adam in self._points.adams.values()]),
            (self._moments["means"], [adam.mean for adam in self._points.adams.values()]),
            (self._moments["squares"], [adam.square for adam in self._points.adams.values()]),
        ):
            put_columns(self.gpu.read(buffer, np.float32, shape), arrays)

    def read_meter(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the sums [N] of the lengths of screen-space gradients, and the number of views [N] that saw each point."""
        found = self.gpu.read(self.drawing.buffers["meter"], np.float32, (2, self.drawing.count))
        return found[0], found[1]

    def read_static_meter(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the same of the static points, [S]."""
        assert self._scene is not None
        found = self.gpu.read(self._scene.meter, np.float32, (2, self._scene.count))
        return found[0], found[1]

    def block(self, place: int) -> np.ndarray:
        """Return the uniform block of a view of `images.all_views`, without what the kind of training adds."""
        draw, view, cameras = uniforms.new_draw(), self.images.all_views[place], len(self.images.views)
        uniforms.fill_view(draw, view.viewmat, view.K, view.width, view.height, self.images.near, view.antialias)
        if view.background is not None:
            draw["background"][:3] = view.background
        draw["counts"] = self.drawing.count, (self.drawing.columns - 14) // 3, 0, self.drawing.capacity
        draw["numbers"][1] = place % cameras
        draw["links"][3] = cameras
        return draw

    def set_loss(self, draw: np.ndarray, lambda_dssim: float) -> None:
        """Fill the weights of the photometric loss."""
        width, height = self.drawing.size
        draw["loss"][:2] = (1 - lambda_dssim) / (3 * width * height), lambda_dssim / (3 * width * height)
        draw["meters"][2] = lambda_dssim

    def static_buffers(self, draw: np.ndarray, place: int, measured: bool) -> Buffers:
        """Return the buffers of the static points of a view of `images.all_views`, and make room for their pairs."""
        if self._scene is None or self._scene.count == 0:
            self.drawing.fit_pairs(0)
            return {}
        view, still = self.images.all_views[place], draw.copy()
        still["center"][3] = max(self.images.near, view.clear)
        found = self._scene.view(place, still, self.drawing)
        self.drawing.fit_pairs(0, self._scene.pairs, measured)
        draw["counts"][2:] = self._scene.count, self.drawing.capacity
        return found | {"static_meter": self._scene.meter}

    def target(self, draw: np.ndarray, frame: int, place: int) -> Any:
        """Return the buffer with the training image of a view of `images.all_views`, and note its place in the block."""
        assert self._pool is not None
        camera = place % len(self.images.views)
        images = self.images if place == camera else self.images.opposite
        assert images is not None

        def load() -> np.ndarray:
            image = images.pixels[frame, camera]
            unknown = np.zeros(image.shape[:2], np.uint8)
            if images.unknown is not None:
                unknown[:] = 255 * images.unknown[frame, camera]
            return np.dstack([image, unknown])

        buffer, first = self._pool.get(frame, place, load)
        draw["numbers"][2] = first
        return buffer

    def run_batch(
        self, count: int, prepare: Callable[[int], tuple[np.ndarray, Buffers]], record: Callable[..., None]
    ) -> list[Outcome]:
        """Run draws, and wait for their results. Draws whose pairs did not fit run again with more room.

        Args:
            count: Number of draws, up to `MOST_DRAWS`.
            prepare: Function from the number of a draw to its uniform block and its buffers.
            record: Function that records the dispatches of a draw, from the recording, the block and the buffers.

        Raises:
            GaussiansError: A value is NaN or infinite.
            GpuError: The device was lost, or has too little memory.
        """
        first, found = 0, list[Outcome]()
        while first < count:
            for k in range(first, count):
                draw, buffers = prepare(k)
                draw["numbers"][3] = k
                self.gpu.write(self.drawing.buffers["draw"], draw)
                recording: Recording = self.gpu.record()
                record(recording, draw, self.drawing.alone() | buffers | {"results": self._results})
                recording.submit()
            rows = self.gpu.read(self._results, np.float32, (count, 4))[first:]
            for loss, slope, done, broken in rows:
                if not done:
                    break
                if broken or not np.isfinite(loss):
                    self.gpu.write(self.drawing.buffers["status"], np.zeros(2, np.uint32))
                    raise GaussiansError(f"the training error is {'not finite' if broken else loss}")
                found.append(Outcome(float(loss), float(slope)))
            first = len(found)
            if first < count:
                self.drawing.grow(self.drawing.needed_pairs())
        return found

    def _stored(self, name: str, arrays: Mapping[str, np.ndarray]) -> Buffers:
        """Copy arrays to buffers that are kept under a name, new ones only if a size changed."""
        held = self._adam_buffers.setdefault(name, {})
        for label, array in arrays.items():
            data = np.ascontiguousarray(array)
            if label not in held or held[label][1] != data.nbytes:
                held[label] = self.gpu.zeros(data.nbytes, f"{label} of the {name}"), data.nbytes
                self.gpu.forget_buffers()
            if data.nbytes:
                self.gpu.write(held[label][0], data)
        return {label: buffer for label, (buffer, _) in held.items()}


def adam_row(rate: float, steps: int, eps: float) -> tuple[float, float, float, float]:
    """Return the constants of a step of Adam in the form of the kernels. steps: number of this step, from 1."""
    decay, square_decay = DECAYS
    return rate / (1 - decay**steps), 1 / (1 - square_decay**steps) ** 0.5, eps, 1.0


def _columns(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Return rows of several arrays [N, ...] as columns [P, N] float32."""
    return np.concatenate(
        [np.ascontiguousarray(array.reshape(len(array), math.prod(array.shape[1:])).T) for array in arrays]
    )


def put_columns(columns: np.ndarray, arrays: Sequence[np.ndarray]) -> None:
    """Copy columns [P, N] into arrays [N, ...], in place."""
    start = 0
    for array in arrays:
        width = math.prod(array.shape[1:])
        array[...] = columns[start : start + width].T.reshape(array.shape)
        start += width
