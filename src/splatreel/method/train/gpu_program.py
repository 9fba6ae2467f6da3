"""Iterations of keyframes and groups on a GPU: points and images on the device, and batches of draws."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from splatreel.base.errors import GaussiansError, GpuError
from splatreel.gpu.device import Gpu, Recording
from splatreel.gpu.drawing import (
    ABSOLUTE,
    AFTER,
    APPEARANCE,
    BEFORE,
    BETWEEN,
    BOUNDED,
    DRAWN,
    END,
    LEARNS_GAINS,
    METERED,
    METERED_STATIC,
    MOVED,
    SCALED_STEPS,
    SHADED,
    START,
    TINTED,
    WHOLE,
    Buffers,
    Drawing,
    StaticScene,
    fill_view,
    new_draw,
)
from splatreel.method.deform.appearance import LAMBDA, RATES
from splatreel.method.deform.knot_adam import DECAYS, KnotAdam
from splatreel.method.deform.spline import Spline
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.train.losses import weight_of
from splatreel.method.train.programs import (
    MOST_DRAWS,
    Draw,
    GroupProgram,
    GroupState,
    KeyframeDraw,
    KeyframeProgram,
    KeyframeState,
    Outcome,
)
from splatreel.method.train.render import StaticCache
from splatreel.method.train.terms.opacity import Opacity
from splatreel.method.train.terms.photometric import LAMBDA_DSSIM
from splatreel.method.train.terms.rigidity import Rigidity
from splatreel.method.train.terms.smoothness import Smoothness
from splatreel.method.train.terms.surfaces import Roughness, Spread
from splatreel.method.train.terms.term import Neighbors
from splatreel.method.train.terms.view_dependence import ViewDependence
from splatreel.method.train.trainable_points import NAMES, TrainablePoints
from splatreel.method.train.training_images import TrainingImages

BOUND = 4e9
"""Bytes that images take on the device at most. A group of 35 frames of 20 cameras at 1352x1014 takes 3.8 GB."""
CHUNK = 2.5e8
"""Bytes of one buffer of images at most. Buffers are allocated when they are needed."""


class ImagePool:
    """Images of one size, in buffers with room for many. The one that was not used for the longest time is replaced."""

    def __init__(self, gpu: Gpu, width: int, height: int, count: int, bound: float = BOUND) -> None:
        """Make room for `count` images in at most `bound` bytes."""
        self._gpu = gpu
        self._bytes = 4 * width * height
        fits = max(int(min(bound // self._bytes, count)), 2)
        self._in_buffer = max(min(int(min(gpu.largest, CHUNK) // self._bytes), fits), 1)
        self._slots = -(-fits // self._in_buffer) * self._in_buffer
        self._buffers: list[Any] = []
        self._held: OrderedDict[tuple[int, int], int] = OrderedDict()

    def get(self, frame: int, camera: int, load: Callable[[], np.ndarray]) -> tuple[Any, int]:
        """Return the buffer of an image, and the number of its first pixel there.

        `load` gives [H, W, 4] uint8: color, 0 where known.
        """
        key = frame, camera
        if key in self._held:
            self._held.move_to_end(key)
        else:
            slot = self._free_slot()
            self._held[key] = slot
            self._gpu.write(self._buffers[slot // self._in_buffer], load(), slot % self._in_buffer * self._bytes)
        slot = self._held[key]
        return self._buffers[slot // self._in_buffer], slot % self._in_buffer * self._bytes // 4

    def _free_slot(self) -> int:
        """Return the number of a slot whose contents are no longer needed. Where memory is short, there are fewer slots."""
        if len(self._held) == self._in_buffer * len(self._buffers) and len(self._held) < self._slots:
            try:
                self._buffers.append(self._gpu.zeros(self._in_buffer * self._bytes, "the images"))
            except GpuError:
                if not self._buffers:
                    raise
                self._slots = len(self._held)
        return len(self._held) if len(self._held) < self._slots else self._held.popitem(last=False)[1]


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
    """Points, static points and images on a GPU."""

    def __init__(self, gpu: Gpu, points: TrainablePoints, static: StaticCache | None, images: TrainingImages) -> None:
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
        """Copy the canonical points to the device, and their moments unless they are there, and choose the image size."""
        gpu, adams = self.gpu, list(self._points.adams.values())
        origins, before = self._points.origins, self.drawing.count
        width, height = images.views[0].width, images.views[0].height
        if self._pool is None or self.drawing.size != (width, height) or images is not self.images:
            self.images = images
            self._pool = ImagePool(gpu, width, height, images.count * len(images.all_views))
            if self._scene is not None:
                self._scene.forget_views()
        self.drawing.set_points(_columns([adam.parameter for adam in adams]))
        self.drawing.set_size(width, height)
        self.drawing.fit_pairs(FIRST_PAIRS * self.drawing.count)
        if origins is None:
            moments = {
                "means": _columns([adam.mean for adam in adams]),
                "squares": _columns([adam.square for adam in adams]),
            }
            self._moments = self._stored("points", moments)
        elif not np.array_equal(origins, np.arange(before)):
            self._move_moments(origins, before)
        self._points.origins = None
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

    def _move_moments(self, origins: np.ndarray, before: int) -> None:
        """Take over the moments of `before` points on the device after rows changed, see `TrainablePoints.origins`."""
        gpu, columns, old = self.gpu, self.drawing.columns, self._moments
        nbytes = 4 * columns * len(origins)
        held = {label: (gpu.zeros(nbytes, f"{label} of the points"), nbytes) for label in old}
        self._adam_buffers["points"] = held
        self._moments = {label: buffer for label, (buffer, _) in held.items()}
        moving = gpu.record()
        used = {
            "length": gpu.uniform(np.array([len(origins), before, columns, 0], np.uint32)),
            "origins": gpu.upload(origins),
            "old_means": old["means"],
            "old_squares": old["squares"],
        }
        moving.run_each(gpu.kernel("move_rows"), columns * len(origins), used | self._moments)
        moving.submit()
        gpu.forget_buffers()

    def download_points(self, moments: bool) -> None:
        """Copy the canonical points to the host. moments: also their moments, which stay on the device otherwise."""
        shape, adams = (self.drawing.columns, self.drawing.count), self._points.adams.values()
        put_columns(
            self.gpu.read(self.drawing.buffers["params"], np.float32, shape), [adam.parameter for adam in adams]
        )
        self._points.origins = None if moments else np.arange(self.drawing.count, dtype=np.int32)
        if moments:
            put_columns(self.gpu.read(self._moments["means"], np.float32, shape), [adam.mean for adam in adams])
            put_columns(self.gpu.read(self._moments["squares"], np.float32, shape), [adam.square for adam in adams])

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
        draw, view, cameras = new_draw(), self.images.all_views[place], len(self.images.views)
        fill_view(draw, view.viewmat, view.K, view.width, view.height, self.images.near, view.antialias)
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

        `prepare` gives the uniform block and the buffers of a draw, `record` records its dispatches.

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

    def _stored(self, name: str, arrays: Mapping[str, np.ndarray | int]) -> Buffers:
        """Copy arrays to buffers that are kept under a name, new ones only if a size changed. A number is one of zeros, float32."""
        held, clearing = self._adam_buffers.setdefault(name, {}), self.gpu.record()
        for label, array in arrays.items():
            nbytes = 4 * array if isinstance(array, int) else array.nbytes
            if label not in held or held[label][1] != nbytes:
                held[label] = self.gpu.zeros(nbytes, f"{label} of the {name}"), nbytes
                self.gpu.forget_buffers()
            elif isinstance(array, int):
                clearing.clear(held[label][0], 0, nbytes)
            if not isinstance(array, int) and nbytes:
                self.gpu.write(held[label][0], np.ascontiguousarray(array))
        clearing.submit()
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


KINDS = {"motion": "0u", "nodes": "1u", "appearance": "2u"}
"""Constants of the kernel `adam_knots`."""


def group_program(opened: Gpu | OwnPrograms, state: GroupState) -> GroupProgram:
    """Return the program of a group on an opened GPU."""
    return GpuGroupProgram(opened, state) if isinstance(opened, Gpu) else opened.group_program(state)


class GpuGroupProgram(GpuProgram):
    """Program of a group, see `Program`. The kernels of the losses are fused."""

    def __init__(self, gpu: Gpu, state: GroupState) -> None:
        points, density, images, config, losses, gains, learns_time = state
        super().__init__(gpu, points.canonical, density.static, images)
        self._moving = points
        self._density = density
        self._config = config
        self._losses = losses
        self._gains = gains
        self.learns_time = learns_time
        self._motion: Buffers = {}
        self._knots: dict[str, tuple[KnotAdam, Buffers]] = {}
        self.neighbors: Neighbors | None = None

    @property
    def _model(self) -> Trajectory:
        assert isinstance(self._moving.deformation, Trajectory)
        return self._moving.deformation

    def upload(self) -> None:
        """See `Program`."""
        self.upload_points(self.images)
        alive = self._density.static.alive
        self.upload_static(alive, alive & self._density.convertible)
        model, appearance = self._model, self._moving.appearance
        index, share = model.skin
        nodes, n = len(model.nodes), len(self._moving)
        starts, links = _links(index, share, nodes)
        neighbors = self.neighbors or Neighbors(np.zeros((0, n), np.int64), np.zeros((0, n), np.float32))
        sources, source_starts = _sources(neighbors.index, n)
        skin = np.stack([index.T.astype(np.uint32), _bits(share.T)], -1)
        near = np.stack([neighbors.index.astype(np.uint32), _bits(neighbors.closeness)], -1)
        self._motion = self._stored(
            "motion",
            {
                "skin": skin,
                "moves": model.moves[:, 0],
                "node_starts": starts,
                "links": links,
                "neighbors": near,
                "starts": source_starts,
                "sources": sources,
                "d_nodes": 28 * nodes,
                "slopes": -(-n // self.gpu.group) + 1,
                "gains": self._gains.values,
                "gain_means": 3 * len(self.images.views),
                "gain_squares": 3 * len(self.images.views),
            },
        )
        adams = {"nodes": model.adams[0], "motion": model.adams[1]}
        if appearance is not None:
            adams["appearance"] = appearance.adam
        for name, adam in adams.items():
            state = {"controls": _planes(adam.values), "means": _planes(adam.mean), "squares": _planes(adam.square)}
            self._knots[name] = adam, self._stored(name, state)

    def run(self, draws: Sequence[Draw]) -> list[Outcome]:
        """See `Program`."""
        canonical = list(self._points.adams.values())
        steps = [adam.steps for adam in canonical]
        knot_steps = {name: adam.steps for name, (adam, _) in self._knots.items()}

        def prepare(k: int) -> tuple[np.ndarray, Buffers]:
            return self._prepare(
                draws[k], [step + k + 1 for step in steps], {n: s + k + 1 for n, s in knot_steps.items()}
            )

        found = self.run_batch(len(draws), prepare, self._record)
        for adam in (*canonical, *(adam for adam, _ in self._knots.values())):
            adam.steps += len(draws)
        return found

    def give_meters(self) -> None:
        """See `Program`."""
        density = self._density
        density.moving_meter.sum, density.moving_meter.seen = self.read_meter()
        density.static_meter.sum, density.static_meter.seen = self.read_static_meter()

    def download(self, moments: bool = True) -> None:
        """See `Program`."""
        self.download_points(moments)
        for adam, held in self._knots.values():
            knots, rows, width = adam.values.shape
            for label, array in (("controls", adam.values), ("means", adam.mean), ("squares", adam.square)):
                array[...] = self.gpu.read(held[label], np.float32, (knots, width, rows)).transpose(0, 2, 1)

    def _prepare(self, draw: Draw, steps: list[int], knot_steps: dict[str, int]) -> tuple[np.ndarray, Buffers]:
        """Return the uniform block and the buffers of a draw. steps: numbers of the steps of Adam."""
        place = self.images.of_iteration(draw.iteration)[1] + draw.camera
        block, unit = self.block(place), self.images.unit
        static = self.static_buffers(block, place, draw.metered_static)
        target = self.target(block, draw.frame, place)
        self.set_loss(block, LAMBDA_DSSIM)
        kinds = ViewDependence, Rigidity, Smoothness
        bands, rigid, smooth = (weight_of(kind, self._losses, draw, self._config) for kind in kinds)
        pixels = self.drawing.size[0] * self.drawing.size[1]
        block["loss"][3] = bands / pixels
        between = draw.span[2] if draw.span else 0.0
        block["motion"] = unit, rigid, smooth, between
        block["shade_rates"], block["shade_price"] = RATES, LAMBDA
        model, appearance = self._model, self._moving.appearance
        knots = 0 if appearance is None else appearance.spline.knots
        block["rows"] = len(model.nodes), model.skin[0].shape[1], model.knots, knots
        block["links"][:3] = draw.rank or 0, 4 if draw.span else 1, model.reached + 1
        self._set_moments(block, draw)
        block["numbers"][0] |= (
            MOVED
            | SHADED * (appearance is not None)
            | WHOLE * draw.whole
            | METERED * draw.metered
            | METERED_STATIC * (draw.metered_static and bool(static))
        )
        for k, (name, adam) in enumerate(self._points.adams.items()):
            rate = self._points.base_rates[name] * draw.pace * 0.1**draw.share
            block["adam"][k] = adam_row(rate, steps[k], adam.eps)
        late = draw.pace * 0.05**draw.share
        for row, (name, rate) in enumerate(
            (("motion", model.RATES[1]), ("nodes", model.RATES[0]), ("appearance", 1.0)), start=6
        ):
            if name in self._knots:
                block["adam"][row] = adam_row(late * rate, knot_steps[name], self._knots[name][0].eps)
        return block, static | self._motion | {"targets": target}

    def _set_moments(self, block: np.ndarray, draw: Draw) -> None:
        """Fill the knots and weights of the moments of a draw."""
        moments = {DRAWN: draw.moment}
        if draw.span:
            start, end, between = draw.span
            moments |= {
                START: start,
                END: end,
                BETWEEN: start + between * (end - start),
            }
        if self.learns_time:
            before, after = max(draw.moment - 0.5, 0.0), min(draw.moment + 0.5, self.images.count - 1.0)
            moments |= {BEFORE: before, AFTER: after}
            block["meters"][1] = 1 / (after - before)
        for place, moment in moments.items():
            _set_moment(block, place, self._model.spline, moment)
        if self._moving.appearance is not None:
            _set_moment(block, APPEARANCE, self._moving.appearance.spline, draw.moment)

    def _record(self, to: Recording, block: np.ndarray, buffers: Buffers) -> None:
        drawing, kernel = self.drawing, self.gpu.kernel
        n = drawing.count
        nodes = int(block["rows"][0])
        controls = {name: held["controls"] for name, (_, held) in self._knots.items()}
        splines = {
            "points": controls["motion"],
            "nodes": controls["nodes"],
            "appearance": controls.get("appearance", buffers["empty"]),
        }
        moments = 6 if self.learns_time else int(block["links"][1])
        to.run_each(kernel("deform"), n, buffers | splines, moments)
        drawing.record_pairs(to, buffers)
        drawing.record_image(to, buffers)
        drawing.record_loss(to, buffers)
        if int(block["numbers"][0]) & METERED_STATIC:
            start = 36 * int(block["counts"][3])
            to.clear(buffers["slots"], start, buffers["slots"].size - start)
        drawing.record_splat_gradients(to, buffers)
        drawing.record_point_gradients(to, buffers)
        if block["motion"][1] and self.neighbors is not None:
            to.run_each(kernel("rigidity"), n, buffers)
        if block["links"][1] > 1:
            to.run_each(kernel("smoothness"), 7 * n, buffers)
        if nodes:
            to.run(kernel("nodes"), (nodes, 1, int(block["links"][1])), buffers | {"starts": buffers["node_starts"]})
        if self.learns_time:
            to.run_each(kernel("time_slope"), n, buffers)
        if int(block["numbers"][0]) & METERED_STATIC:
            to.run_each(kernel("static_meter"), int(block["counts"][2]), buffers)
        canonical = {**self._moments, "distances": buffers["moves"], "averages": buffers["empty"]}
        to.run_each(kernel("adam_points"), n * drawing.columns, buffers | canonical)
        for name, (adam, held) in self._knots.items():
            gradients = buffers["d_nodes" if name == "nodes" else "d_offsets"]
            step = kernel("adam_knots", KIND=KINDS[name])
            to.run_each(step, adam.parameter.size, buffers | held | {"gradients": gradients})
        unused = {"means": buffers["gain_means"], "squares": buffers["gain_squares"]}  # gains do not change here
        to.run(kernel("finish"), (1, 1, 1), buffers | unused)


def _set_moment(block: np.ndarray, place: int, spline: Spline, moment: float) -> None:
    """Fill the first knot and the weights of one moment."""
    block["knots"][place, 0], block["weights"][place] = spline.at(moment)


def _bits(values: np.ndarray) -> np.ndarray:
    """Return the bits of float32 values as integers."""
    return np.ascontiguousarray(values, np.float32).view(np.uint32)


def _planes(controls: np.ndarray) -> np.ndarray:
    """Return control values [knots, rows, D] as [knots, D, rows]."""
    return np.ascontiguousarray(controls.transpose(0, 2, 1))


def _links(index: np.ndarray, share: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of each of M nodes: starts [M + 1] of their ranges, and points with the bits of their weights, [N K, 2] uint32.

    Point n has the nodes index[n] [K] with the weights share[n].
    """
    flat = index.reshape(-1)
    order = np.argsort(flat, kind="stable")
    starts = np.searchsorted(flat[order], np.arange(nodes + 1)).astype(np.uint32)
    points = (order // max(index.shape[1], 1)).astype(np.uint32)
    return starts, np.stack([points, _bits(share.reshape(-1))[order]], -1)


def _sources(neighbors: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return, by rank, the points [K, N] ordered by their neighbor, and the start [K, N + 1] of each neighbor's range."""
    order = np.argsort(neighbors, axis=1, kind="stable")
    starts = [np.searchsorted(row[place], np.arange(count + 1)) for row, place in zip(neighbors, order, strict=True)]
    return order.astype(np.uint32), np.array(starts, np.uint32).reshape(len(neighbors), count + 1)


def keyframe_program(opened: Gpu | OwnPrograms, state: KeyframeState) -> KeyframeProgram:
    """Return the program of a keyframe on an opened GPU."""
    return GpuKeyframeProgram(opened, state) if isinstance(opened, Gpu) else opened.keyframe_program(state)


class GpuKeyframeProgram(GpuProgram):
    """Program of a keyframe, see `KeyframeProgram`. The losses are fused."""

    def __init__(self, gpu: Gpu, state: KeyframeState) -> None:
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
                "slopes": 3 * (-(-self.drawing.count // self.gpu.group) + 1),
                "averages": size,
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

    def download(self, moments: bool = True) -> None:
        """See `Program`."""
        self.download_points(moments)
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
        place = self.images.of_iteration(draw.iteration)[1] + draw.camera
        block, view = self.block(place), self.images.all_views[place]
        static = self.static_buffers(block, place, measured=False)
        target = self.target(block, 0, place)
        self.set_loss(block, LAMBDA_DSSIM)
        kinds = Opacity, Spread, Roughness
        faint, before, bent = (weight_of(kind, self._losses, draw, self._state.config) for kind in kinds)
        width, height = self.drawing.size
        block["loss"][2] = faint / (width * height)
        near = self.images.near
        block["surfaces"] = before, bent, near, self.images.unit / near
        block["meters"][0] = draw.average
        if view.gain is not None:
            block["behind"][:3] = view.gain
        block["numbers"][0] |= (
            SCALED_STEPS
            | TINTED * (view.gain is not None)
            | BOUNDED * (self.images.opposite is not None)
            | WHOLE * draw.whole
            | METERED * draw.metered
            | ABSOLUTE * self._state.measures_absolute
            | LEARNS_GAINS * (draw.whole and self._gains.enabled)
        )
        for k, adam in enumerate(self._points.adams.values()):
            block["adam"][k] = adam_row(draw.rates[k], steps[k], adam.eps)
        block["adam"][9] = adam_row(self._gains.adam.rate, max(learned, 1), self._gains.adam.eps)
        return block, static | self._shared | {"targets": target}

    def _record(self, to: Recording, block: np.ndarray, buffers: Buffers) -> None:
        drawing, kernel = self.drawing, self.gpu.kernel
        tinted = int(block["numbers"][0]) & TINTED
        drawing.record_pairs(to, buffers)
        if tinted:
            to.run_each(kernel("tint"), drawing.count, buffers)
        drawing.record_image(to, buffers)
        drawing.record_loss(to, buffers)
        drawing.record_splat_gradients(to, buffers)
        if tinted:
            to.run_each(kernel("tint_backward"), drawing.count, buffers)
        if block["surfaces"][0] or block["surfaces"][1]:
            drawing.record_surfaces(to, buffers)
        drawing.record_point_gradients(to, buffers)
        to.run_each(kernel("adam_points"), drawing.count * drawing.columns, buffers | self._moments)
        gains = {"means": buffers["gain_means"], "squares": buffers["gain_squares"]}
        to.run(kernel("finish"), (1, 1, 1), buffers | gains)
