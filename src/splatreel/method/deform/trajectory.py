"""Deformation model `trajectory`: an explicit temporal basis on shared nodes and per point.

Every offset is a cubic B-spline in time, the sum of two levels. Nodes are shared by the points around them and move whole limbs
at once; the level of the points adds the remainder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import adam, motion, splat
from splatreel.method.deform.knot_adam import KnotAdam, Restore, merge_snapshots
from splatreel.method.deform.protocol import movable, movable_with
from splatreel.method.deform.spline import Spline

DIMENSIONS = 7
"""Components of an offset: dx, and dq less its identity."""


Slopes = tuple[int, np.ndarray, tuple[Tensor, Tensor]]
"""First knot of a moment, the weights [4] of its knots, and the gradients [M, 7] and [N, 7] to the splines of nodes and points."""


@dataclass
class Evaluation:
    """Offsets at one moment, and what their gradient needs.

    Attributes:
        knot: First of the four knots that determine the moment.
        weights: Weights [4] of these knots.
        dx: [N, 3], a leaf.
        dq: [N, 4], a leaf.
    """

    knot: int
    weights: np.ndarray
    dx: Tensor
    dq: Tensor
    _slopes: tuple[Tensor, Tensor] | None = None

    @property
    def has_gradient(self) -> bool:
        """Return whether the loss depends on the offsets."""
        return self.dx.grad is not None or self.dq.grad is not None

    def slopes(self, model: Trajectory) -> tuple[Tensor, Tensor]:
        """Return the gradients [M, 7] and [N, 7] with respect to the splines of nodes and points at the moment."""
        if self._slopes is None:
            d_dx, d_dq = (torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for leaf in (self.dx, self.dq))
            nodes, points = motion.offsets_gradient(d_dx, d_dq, model.skin, len(model.nodes), model.unit)
            self._slopes = nodes, points * model.moves
        return self._slopes


class Trajectory:
    """Model of splines, see `Deformation`. Control values are [knots, rows, 7] in units of `unit`."""

    NODES = 64
    RATES = (5e-4, 1.5e-4)
    """Learning rates of the nodes and of the points."""
    EXTRAPOLATION = 0.8

    def __init__(
        self,
        means: Tensor,
        frames: int,
        unit: float,
        seed: int = 0,
        tracks: Tensor | None = None,
        fixed: Tensor | None = None,
    ) -> None:
        """Create a model.

        Args:
            means: [N, 3] canonical positions.
            frames: Number of frames, T.
            unit: Typical viewing distance, world units.
            seed: Seed of the choice of nodes.
            tracks: [T, N, 3] initial positions; None is at rest.
            fixed: [N] bool, points that never move; None for none.
        """
        device = means.device
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
        controls = [torch.zeros(self.knots, n, DIMENSIONS, device=device) for n in (len(self.nodes), len(means))]
        if paths is not None:  # the level of the points starts as the smoothest spline close to the tracks
            controls[1][..., :3] = self.spline.fit(paths)
        self.adams = [KnotAdam(level, rate, eps=1e-12) for level, rate in zip(controls, self.RATES, strict=True)]
        self.evaluations: list[Evaluation] = []

    @property
    def controls(self) -> tuple[Tensor, Tensor]:
        """Control values of the nodes and of the points, [knots, rows, 7]."""
        return self.adams[0].values, self.adams[1].values

    def offsets(self, means: Tensor, frame: float) -> tuple[Tensor, Tensor]:
        """See `Deformation`. The results are leaves, whose gradients the next step follows."""
        knot, weights = self.spline.at(frame)
        nodes, points = (level.current(knot, knot + 4) for level in self.adams)
        dx, dq = motion.offsets((nodes, points), knot, weights, self.skin, self.unit)
        if torch.is_grad_enabled():
            self.evaluations.append(Evaluation(knot, weights, dx.requires_grad_(), dq.requires_grad_()))
        return dx, dq

    @torch.no_grad()
    def change(self, means: Tensor, span: tuple[float, float], offsets: tuple[Tensor, Tensor]) -> Tensor:
        """See `Deformation`. Offsets are linear in the control values, so products with a few of these give the change."""
        slopes = next(seen for seen in self.evaluations if seen.dx is offsets[0]).slopes(self)
        (first, before), (last, after) = (self.spline.at(frame) for frame in span)
        weights = np.zeros(last + 4 - first, np.float32)
        weights[last - first :] += after
        weights[:4] -= before
        levels = zip((level.current(first, last + 4) for level in self.adams), slopes, strict=True)
        products = [controls[first : last + 4].flatten(1) @ slope.flatten() for controls, slope in levels]
        return torch.from_numpy(weights).to(means.device) @ torch.stack(products).sum(0)

    def extend_to(self, frame: float) -> None:
        """Extrapolate the control values that no earlier frame used."""
        needed = self.spline.at(frame)[0] + 3
        with torch.no_grad():
            while self.reached < needed:
                self.reached += 1
                k = self.reached
                for controls in (level.current(k - 2, k) for level in self.adams):
                    controls[k] = controls[k - 1] + self.EXTRAPOLATION * (controls[k - 1] - controls[k - 2])

    def step(self, share: float, pace: float = 1.0) -> None:
        """See `Deformation`."""
        known = [(seen.knot, seen.weights, seen.slopes(self)) for seen in self.evaluations if seen.has_gradient]
        self.evaluations.clear()
        adam.adam(self.follow(known, share, pace))

    def follow(self, known: Sequence[Slopes], share: float, pace: float) -> list[adam.Step]:
        """Return the optimizer steps for gradients at some moments. share, pace: see `Deformation.step`."""
        taken = []
        for level, (knots, rate) in enumerate(zip(self.adams, self.RATES, strict=True)):
            knots.rate = pace * rate * 0.05**share
            end = self.reached + 1  # later knots have not been trained, and stay zero
            taken.append(knots.at([(knot, weights, slopes[level]) for knot, weights, slopes in known], end))
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
            self.evaluations.clear()

        return restore

    def check(self) -> None:
        """See `Deformation`."""
        nodes, points = self.controls
        splat.check_finite(motion=points, nodes=nodes)

    def keep(self, index: Tensor) -> None:
        """See `Deformation`."""
        self.evaluations.clear()
        self.skin = (self.skin[0][index], self.skin[1][index])
        self.moves = self.moves[index]
        self.adams[1].rewrite(lambda rows: rows[:, index], lambda rows: rows[:, index])

    def append(self, means: Tensor, parents: Tensor | None) -> None:
        """Add points. Points without parents start with a total offset of zero, since they were static."""
        self.evaluations.clear()
        index, share = skin(means, self.nodes)
        moves = movable_with(self.moves, means, parents)
        self.moves = torch.cat([self.moves, moves])
        share = share * moves
        self.skin = torch.cat([self.skin[0], index]), torch.cat([self.skin[1], share])
        nodes, points = self.controls
        rows = points[:, parents] if parents is not None else -torch.einsum("nk,tnkd->tnd", share, nodes[:, index])
        state = torch.zeros_like(rows)
        self.adams[1].rewrite(lambda t: torch.cat([t, rows], 1), lambda t: torch.cat([t, state], 1))


def farthest_points(points: Tensor, count: int, seed: int) -> Tensor:
    """Return the indices [count] of evenly spread points: each is the farthest from the ones before it."""
    chosen = torch.empty(count, dtype=torch.int64, device=points.device)
    distance = torch.full((len(points),), torch.inf, device=points.device)
    current = seed % len(points)
    for i in range(count):
        chosen[i] = current
        distance = torch.minimum(distance, (points - points[current]).square().sum(1))
        current = int(distance.argmax())
    return chosen


def skin(points: Tensor, nodes: Tensor) -> tuple[Tensor, Tensor]:
    """Return the four nearest nodes of every point, [N, 4], and their weights [N, 4], which sum to one; [N, 0] without nodes."""
    if len(nodes) == 0:
        return points.new_zeros(len(points), 0, dtype=torch.int64), points.new_zeros(len(points), 0)
    index, distance = splat.nearest_neighbors(nodes, min(4, len(nodes)), queries=points)
    width = distance[:, -1].median().clamp_min(1e-9)
    weights = torch.exp(-2 * (distance / width) ** 2) + 1e-6
    return index, weights / weights.sum(1, keepdim=True)
