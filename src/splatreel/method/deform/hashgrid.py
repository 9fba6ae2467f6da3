"""Deformation model `hashgrid` of the paper: a 4D hash grid decoded by small MLPs (paper section 4.2, after Grid4D).

Four multiresolution hash grids are used: one in space (xyz) and three in space-time (xyt, xzt, yzt, coarser along t). As in
Grid4D, the spatial feature gates the space-time features by a factor in -1..1. Without the gate, neighboring points drift
apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np

from splatreel.kernels import adam, hashgrid, motion, splat
from splatreel.method.deform.knot_adam import Adam, Restore, merge_snapshots
from splatreel.method.deform.protocol import movable, movable_with
from splatreel.method.deform.spline import Spline

AXES = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
TIME_SPAN = 0.9
"""Share of the unit interval that a group's time spans."""
IDENTITY = np.array([1, 0, 0, 0], np.float32)


class Slope(NamedTuple):
    """Gradients to the offsets at one moment, and to all parameters by name."""

    dx: np.ndarray
    dq: np.ndarray
    parameters: dict[str, np.ndarray]


class HashGrid:
    """Hash grid model, see `Deformation`.

    Tracks are kept as splines of the points, [knots, N, 3], and the grid learns the remainder. A grid fitted to the tracks
    would couple objects that pass close to each other, since they share cells.

    Attributes:
        adams: Optimizers of the tables [L, T, F] of the grids, of the weights [inputs, outputs] and of the biases [outputs].
    """

    LEVELS = 12
    FEATURES = 2
    LOG2_ENTRIES = 15
    SPATIAL_RESOLUTIONS = (16, 512)
    SPACE_TIME_RESOLUTIONS = ((8, 128), (4, 24))
    """Coarsest and finest resolution, of the two space axes and of time."""
    WIDTH = 64
    GRID_RATE, NETWORK_RATE = 4e-3, 1e-3
    HEAD_DEVIATION = 1e-2
    """Standard deviation of the initial weights of the last layers. Offsets start near zero."""

    def __init__(
        self,
        means: np.ndarray,
        frames: int,
        unit: float,
        seed: int = 0,
        tracks: np.ndarray | None = None,
        fixed: np.ndarray | None = None,
    ) -> None:
        """Create a model, see `make_deformation`. The network's output is in a tenth of `unit`."""
        self.moves = movable(means, fixed)
        paths = None if tracks is None else tracks - means
        self.spline = Spline(frames) if paths is None else Spline.along(paths)
        self.tracks = None if paths is None else self.spline.fit(paths)
        self.unit = unit
        low, high = means.min(0), means.max(0)
        margin = 0.1 * unit
        self.low = low - margin
        self.extent = (high - low + 2 * margin).max()
        space = geometric(*self.SPATIAL_RESOLUTIONS, self.LEVELS)
        plane, time = (geometric(*r, self.LEVELS) for r in self.SPACE_TIME_RESOLUTIONS)
        self.resolutions = [
            np.stack([space] * 3, 1) if 3 not in axes else np.stack([plane, plane, time], 1) for axes in AXES
        ]
        start = self._start(np.random.default_rng(seed))
        self.adams = {name: Adam(value, self._rate(name), eps=1e-15) for name, value in start.items()}

    def prepare(self, times: Iterable[float]) -> None:
        """Do nothing: all optimizer steps are taken at once."""

    def extend_to(self, frame: float) -> None:
        """Do nothing: the grid is defined at all times."""

    def offsets(self, means: np.ndarray, frame: float) -> tuple[np.ndarray, np.ndarray]:
        """See `Deformation`."""
        dx, dq = _decode(self._values, self._features(self._coordinates(means, [frame])))[-1]
        dx *= 0.1 * self.unit
        if self.tracks is not None:
            knot, weights = self.spline.at(frame)
            dx += motion.spline(self.tracks[knot : knot + 4], weights)
        return dx * self.moves, dq * (0.1 * self.moves) + IDENTITY

    def gradient(
        self, means: np.ndarray, moments: Sequence[tuple[float, float]], d_dx: np.ndarray, d_dq: np.ndarray
    ) -> list[Slope]:
        """See `Deformation`. Positions are constants: the grid would move the points to where it is smooth."""
        coordinates = self._coordinates(means, [time for _, time in moments])
        values, features = self._values, self._features(coordinates)
        heads = d_dx * (0.1 * self.unit * self.moves), d_dq * (0.1 * self.moves)
        d_heads = [np.concatenate([np.float32(factor) * head for factor, _ in moments]) for head in heads]
        found, d_features = _decode_gradient(values, features, d_heads)
        grids = zip(AXES, self.resolutions, d_features, strict=True)
        for k, (axes, resolutions, d_feature) in enumerate(grids):
            at, table = np.ascontiguousarray(coordinates[:, axes]), values[f"grid{k}"]
            found[f"grid{k}"] = hashgrid.table_gradient(at, table, d_feature, resolutions)
        return [Slope(d_dx, d_dq, found)]

    def change(self, means: np.ndarray, span: tuple[float, float], slopes: Sequence[Slope]) -> float:
        """See `Deformation`."""
        [slope] = slopes
        before, after = (self.offsets(means, frame) for frame in span)
        parts = zip(before, after, (slope.dx, slope.dq), strict=True)
        return sum(float(((b - a) * d).sum(dtype=np.float64)) for a, b, d in parts)

    def steps(self, slopes: Sequence[Slope], share: float, pace: float) -> list[adam.Step]:
        """See `Deformation`."""
        found = []
        for name, one in self.adams.items() if slopes else ():
            one.rate = pace * self._rate(name) * 0.02**share
            found.append(one.follow(reduce(np.add, [slope.parameters[name] for slope in slopes])))
        return found

    def snapshot(self) -> Restore:
        """See `Deformation`."""
        parameters = merge_snapshots([one.snapshot() for one in self.adams.values()])
        moves, tracks = self.moves, self.tracks  # replaced, never changed in place

        def restore() -> None:
            parameters()
            self.moves = moves
            self.tracks = tracks

        return restore

    def check(self) -> None:
        """See `Deformation`."""
        splat.check_finite(**self._values)

    def keep(self, index: np.ndarray) -> None:
        """See `Deformation`."""
        self.moves = self.moves[index]
        if self.tracks is not None:
            self.tracks = np.ascontiguousarray(self.tracks[:, index])

    def append(self, means: np.ndarray, parents: np.ndarray | None) -> None:
        """Add points. Copies take the tracks of their parents; new points have none, and move with the grid."""
        self.moves = np.concatenate([self.moves, movable_with(self.moves, means, parents)])
        if self.tracks is not None:
            zeros = np.zeros((len(self.tracks), len(means), 3), np.float32)
            added = zeros if parents is None else self.tracks[:, parents]
            self.tracks = np.concatenate([self.tracks, added], 1)

    @property
    def _values(self) -> dict[str, np.ndarray]:
        return {name: one.parameter for name, one in self.adams.items()}

    def _rate(self, name: str) -> float:
        return self.GRID_RATE if name.startswith("grid") else self.NETWORK_RATE

    def _start(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        shape = (self.LEVELS, 2**self.LOG2_ENTRIES, self.FEATURES)
        start = {f"grid{k}": rng.uniform(-1e-4, 1e-4, shape) for k in range(len(AXES))}
        features = self.LEVELS * self.FEATURES
        hidden = {"gate": features, "motion": 3 * features, "dx": self.WIDTH, "dq": self.WIDTH}
        for name, inputs in hidden.items():
            start |= random_layer(name, inputs, self.WIDTH, rng)
        start["gate_bias"] = np.ones(self.WIDTH)
        for name, outputs in (("dx", 3), ("dq", 4)):
            start[f"{name}_out"] = rng.normal(0, self.HEAD_DEVIATION, (self.WIDTH, outputs))
            start[f"{name}_out_bias"] = np.zeros(outputs)
        return start

    def _coordinates(self, means: np.ndarray, times: Sequence[float]) -> np.ndarray:
        """Return the coordinates [T * N, 4] of points at T times in the unit cube of space and time."""
        space = np.clip((means - self.low) / self.extent, 0, np.float32(1 - 1e-6))
        columns = [np.full((len(space), 1), time / self.spline.last * TIME_SPAN, np.float32) for time in times]
        return np.concatenate([np.concatenate([space, column], 1) for column in columns])

    def _features(self, coordinates: np.ndarray) -> list[np.ndarray]:
        """Return the features [R, L * F] of the four grids at coordinates [R, 4]."""
        values = self._values
        return [
            hashgrid.forward(np.ascontiguousarray(coordinates[:, axes]), values[f"grid{k}"], resolutions)
            for k, (axes, resolutions) in enumerate(zip(AXES, self.resolutions, strict=True))
        ]


def _decode(
    values: dict[str, np.ndarray], features: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return the network's input of motion, its gate, the hidden values, those within both heads, and the heads dx and dq."""
    joined = np.concatenate(features[1:], 1)
    gate = np.tanh(linear(values, "gate", features[0]) / 2)  # 2 sigmoid(x) - 1
    moved = np.maximum(linear(values, "motion", joined), 0)
    hidden = gate * moved
    inner = {name: np.maximum(linear(values, name, hidden), 0) for name in ("dx", "dq")}
    heads = linear(values, "dx_out", inner["dx"]), linear(values, "dq_out", inner["dq"])
    return joined, gate, moved, inner, heads


def _decode_gradient(
    values: dict[str, np.ndarray], features: list[np.ndarray], d_heads: Sequence[np.ndarray]
) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
    """Return the gradients to the network's parameters, by name, and to the features of the four grids."""
    found: dict[str, np.ndarray] = {}
    joined, gate, moved, inner, _ = _decode(values, features)
    hidden, d_hidden = gate * moved, np.zeros_like(gate)
    for name, d_head in zip(("dx", "dq"), d_heads, strict=True):
        d_inner = linear_gradient(found, values, f"{name}_out", inner[name], d_head) * (inner[name] > 0)
        d_hidden += linear_gradient(found, values, name, hidden, d_inner)
    d_gate = linear_gradient(found, values, "gate", features[0], d_hidden * moved * (1 - gate * gate) / 2)
    d_joined = linear_gradient(found, values, "motion", joined, d_hidden * gate * (moved > 0))
    return found, [d_gate, *(np.ascontiguousarray(part) for part in np.split(d_joined, 3, 1))]


def random_layer(name: str, inputs: int, outputs: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the weights and biases of a linear layer, uniform within 1 / sqrt(inputs), by the names that `linear` reads."""
    reach = inputs**-0.5
    return {name: rng.uniform(-reach, reach, (inputs, outputs)), f"{name}_bias": rng.uniform(-reach, reach, outputs)}


def linear(values: Mapping[str, np.ndarray], name: str, inputs: np.ndarray) -> np.ndarray:
    """Return the outputs [R, O] of a linear layer for inputs [R, I]."""
    return inputs @ values[name] + values[f"{name}_bias"]


def linear_gradient(
    found: dict[str, np.ndarray], values: Mapping[str, np.ndarray], name: str, inputs: np.ndarray, slope: np.ndarray
) -> np.ndarray:
    """Record the gradients of a linear layer in `found`, and return the gradient to its inputs. slope: [R, O], to its outputs."""
    found[name], found[f"{name}_bias"] = inputs.T @ slope, slope.sum(0)
    return slope @ values[name].T


def geometric(low: int, high: int, levels: int) -> np.ndarray:
    """Return the resolutions [levels] of a grid, from the coarsest to the finest."""
    return np.floor(low * (high / low) ** (np.arange(levels) / max(levels - 1, 1))).astype(np.int64)
