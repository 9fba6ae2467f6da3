"""Iterations of a group on a GPU."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splatreel.gpu import uniforms
from splatreel.gpu.device import Gpu, Recording
from splatreel.gpu.drawing import Buffers
from splatreel.method.deform.appearance import LAMBDA, RATES
from splatreel.method.deform.knot_adam import KnotAdam
from splatreel.method.deform.spline import Spline
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.train.gpu_program import GpuProgram, OwnPrograms, adam_row
from splatreel.method.train.losses import LAMBDA_DSSIM, weight_of
from splatreel.method.train.programs import Draw, GroupProgram, GroupState, Outcome
from splatreel.method.train.regularizers import Neighbors
from splatreel.method.train.terms.rigidity import Rigidity
from splatreel.method.train.terms.smoothness import Smoothness
from splatreel.method.train.terms.view_dependence import ViewDependence

KINDS = {"motion": "0u", "nodes": "1u", "appearance": "2u"}
"""Constants of the kernel `adam_knots`."""


def group_program(opened: Gpu | OwnPrograms, state: GroupState) -> GroupProgram:
    """Return the program of a group on an opened GPU."""
    return GpuGroupProgram(opened, state) if isinstance(opened, Gpu) else opened.group_program(state)


class GpuGroupProgram(GpuProgram):
    """Program of a group, see `Program`. The kernels of the losses are fused."""

    def __init__(self, gpu: Gpu, state: GroupState) -> None:
        """Prepare a program; `upload` follows."""
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
                "d_nodes": np.zeros(28 * nodes, np.float32),
                "slopes": np.zeros(-(-n // self.gpu.group) + 1, np.float32),
                "gains": self._gains.values,
                "gain_means": np.zeros(3 * len(self.images.views), np.float32),
                "gain_squares": np.zeros(3 * len(self.images.views), np.float32),
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

    def download(self) -> None:
        """See `Program`."""
        self.download_points()
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
        flags = uniforms.MOVED
        for flag, on in (
            (uniforms.SHADED, appearance is not None),
            (uniforms.WHOLE, draw.whole),
            (uniforms.METERED, draw.metered),
            (uniforms.METERED_STATIC, draw.metered_static and bool(static)),
        ):
            flags |= flag if on else 0
        block["numbers"][0] |= flags
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
        moments = {uniforms.DRAWN: draw.moment}
        if draw.span:
            start, end, between = draw.span
            moments |= {
                uniforms.START: start,
                uniforms.END: end,
                uniforms.BETWEEN: start + between * (end - start),
            }
        if self.learns_time:
            before, after = max(draw.moment - 0.5, 0.0), min(draw.moment + 0.5, self.images.count - 1.0)
            moments |= {uniforms.BEFORE: before, uniforms.AFTER: after}
            block["meters"][1] = 1 / (after - before)
        for place, moment in moments.items():
            _set_moment(block, place, self._model.spline, moment)
        if self._moving.appearance is not None:
            _set_moment(block, uniforms.APPEARANCE, self._moving.appearance.spline, draw.moment)

    def _record(self, to: Recording, block: np.ndarray, buffers: Buffers) -> None:
        """Record the dispatches of a draw."""
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
        if int(block["numbers"][0]) & uniforms.METERED_STATIC:
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
        if int(block["numbers"][0]) & uniforms.METERED_STATIC:
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
    """Return the points of each node.

    Args:
        index: [N, K] nodes of each point.
        share: [N, K] their weights.
        nodes: Number of nodes, M.

    Returns:
        Starts [M + 1] of the nodes' ranges, and points with the bits of their weights, [N K, 2] uint32.
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
