"""Deformation model `trajectory`: an explicit temporal basis on shared nodes and per point.

Every offset is a cubic B-spline in time, the sum of two levels. Nodes are shared by the points around them and move whole limbs
at once; the level of the points adds the remainder.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from splatreel.kernels import adam, motion, splat
from splatreel.method.deform.knot_adam import KnotAdam, Restore, merge_snapshots
from splatreel.method.deform.protocol import movable, movable_with
from splatreel.method.deform.spline import Spline

DIMENSIONS = 7
"""Components of an offset: dx, and dq less its identity."""


Slopes = tuple[int, np.ndarray, tuple[np.ndarray, np.ndarray]]
"""First knot of a moment, the weights [4] of its knots, and the gradients [M, 7] and [N, 7] to the splines of nodes and points."""


class Trajectory:
    """Model of splines, see `Deformation`. Control values are [knots, rows, 7] in units of `unit`.

    Offsets are linear in the control values, and one time depends on four knots.
    """

    NODES = 64
    RATES = (5e-4, 1.5e-4)
    """Learning rates of the nodes and of the points."""
    EXTRAPOLATION = 0.8

    def __init__(
        self,
        means: np.ndarray,
        frames: int,
        unit: float,
        seed: int = 0,
        tracks: np.ndarray | None = None,
        fixed: np.ndarray | None = None,
    ) -> None:
        """Create a model, see `make_deformation`. `seed` chooses the nodes."""
        self.moves = movable(means, fixed)
        self.unit = unit
        moving = means if fixed is None else means[~fixed]
        few = len(moving) <= self.NODES
        self.nodes = moving[:0] if few else moving[farthest_points(moving, self.NODES, seed)]
        index, share = skin(means, self.nodes)
        paths = None if tracks is None else (tracks - means) / unit
        self.spline = Spline(frames) if paths is None else Spline.along(paths, None if few else index[:, 0])
        self.knots = self.spline.knots
        self.reached = 3 if paths is None else self.knots - 1
        self.skin = index, share * self.moves
        controls = [np.zeros((self.knots, n, DIMENSIONS), np.float32) for n in (len(self.nodes), len(means))]
        if paths is not None:  # the level of the points starts as the smoothest spline close to the tracks
            controls[1][..., :3] = self.spline.fit(paths)
        self.adams = [KnotAdam(level, rate, eps=1e-12) for level, rate in zip(controls, self.RATES, strict=True)]

    @property
    def controls(self) -> tuple[np.ndarray, np.ndarray]:
        """Control values of the nodes and of the points, [knots, rows, 7]."""
        return self.adams[0].values, self.adams[1].values

    def prepare(self, times: Iterable[float]) -> None:
        """See `Deformation`."""
        knots = [self.spline.at(time)[0] for time in times]
        if knots:
            self._levels(min(knots), max(knots) + 4)

    def extend_to(self, frame: float) -> None:
        """Extrapolate the control values that no earlier frame used."""
        needed = self.spline.at(frame)[0] + 3
        while self.reached < needed:
            self.reached += 1
            for before, last, new in self._levels(self.reached - 2, self.reached + 1):
                new[:] = last + self.EXTRAPOLATION * (last - before)

    def offsets(self, means: np.ndarray, frame: float) -> tuple[np.ndarray, np.ndarray]:
        """See `Deformation`."""
        knot, weights = self.spline.at(frame)
        return motion.offsets(*self._levels(knot, knot + 4), weights, self.skin, self.unit)

    def gradient(
        self, means: np.ndarray, moments: Sequence[tuple[float, float]], d_dx: np.ndarray, d_dq: np.ndarray
    ) -> list[Slopes]:
        """See `Deformation`. The gradients to the knots are multiples of one gradient."""
        nodes, points = motion.offsets_gradient(d_dx, d_dq, self.skin, len(self.nodes), self.unit)
        points *= self.moves
        knots = [(factor, *self.spline.at(time)) for factor, time in moments]
        return [(knot, np.float32(factor) * weights, (nodes, points)) for factor, knot, weights in knots]

    def change(self, means: np.ndarray, span: tuple[float, float], slopes: Sequence[Slopes]) -> float:
        """See `Deformation`. Products with a few control values give the change."""
        [(_, _, gradients)] = slopes
        (first, before), (last, after) = (self.spline.at(frame) for frame in span)
        weights = np.zeros(last + 4 - first, np.float32)
        weights[last - first :] += after
        weights[:4] -= before
        levels = zip(self._levels(first, last + 4), gradients, strict=True)
        return sum(motion.product_sum(controls, weights, gradient) for controls, gradient in levels)

    def steps(self, slopes: Sequence[Slopes], share: float, pace: float) -> list[adam.Step]:
        """See `Deformation`."""
        taken = []
        for level, (knots, rate) in enumerate(zip(self.adams, self.RATES, strict=True)):
            knots.rate = pace * rate * 0.05**share
            end = self.reached + 1  # later knots have not been trained, and stay zero
            taken.append(knots.at([(knot, weights, found[level]) for knot, weights, found in slopes], end))
        return [step for step in taken if step is not None]

    def snapshot(self) -> Restore:
        """See `Deformation`."""
        levels = merge_snapshots([level.snapshot() for level in self.adams])
        skin, moves, reached = self.skin, self.moves, self.reached  # replaced, never changed in place

        def restore() -> None:
            levels()
            self.skin = skin
            self.moves = moves
            self.reached = reached

        return restore

    def check(self) -> None:
        """See `Deformation`."""
        nodes, points = self.controls
        splat.check_finite(motion=points, nodes=nodes)

    def keep(self, index: np.ndarray) -> None:
        """See `Deformation`."""
        self.skin = (self.skin[0][index], self.skin[1][index])
        self.moves = self.moves[index]
        self.adams[1].rewrite(lambda rows: rows[:, index], lambda rows: rows[:, index])

    def append(self, means: np.ndarray, parents: np.ndarray | None) -> None:
        """Add points. Points without parents start with a total offset of zero, since they were static."""
        index, share = skin(means, self.nodes)
        moves = movable_with(self.moves, means, parents)
        self.moves = np.concatenate([self.moves, moves])
        share = share * moves
        self.skin = np.concatenate([self.skin[0], index]), np.concatenate([self.skin[1], share])
        nodes, points = self.controls
        rows = points[:, parents] if parents is not None else -np.einsum("nk,tnkd->tnd", share, nodes[:, index])
        state = np.zeros_like(rows)
        self.adams[1].rewrite(lambda t: np.concatenate([t, rows], 1), lambda t: np.concatenate([t, state], 1))

    def _levels(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the knots first..last of the nodes and of the points, which have taken all steps."""
        nodes, points = (level.current(first, last)[first:last] for level in self.adams)
        return nodes, points


def farthest_points(points: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return the indices [count] of evenly spread points: each is the farthest from the ones before it."""
    chosen = np.empty(count, np.int64)
    distance = np.full(len(points), np.inf, np.float32)
    current = seed % len(points)
    for i in range(count):
        chosen[i] = current
        distance = np.minimum(distance, np.square(points - points[current]).sum(1))
        current = int(distance.argmax())
    return chosen


def skin(points: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the four nearest nodes of every point, [N, 4], and their weights [N, 4], which sum to one; [N, 0] without nodes."""
    if len(nodes) == 0 or len(points) == 0:
        columns = min(4, len(nodes))
        return np.zeros((len(points), columns), np.int64), np.zeros((len(points), columns), np.float32)
    index, distance = splat.nearest_neighbors(nodes, min(4, len(nodes)), queries=points)
    width = max(np.quantile(distance[:, -1], 0.5, method="lower"), np.float32(1e-9))
    weights = np.exp(-2 * (distance / width) ** 2) + np.float32(1e-6)
    return index, weights / weights.sum(1, keepdims=True)
