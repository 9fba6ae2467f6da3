"""`trajectory`: an explicit temporal basis on shared nodes and per point, our deformation model.

Every offset is a cubic B-spline in time. Its control values are the sum of levels: nodes shared by the points around them,
which move whole limbs at once, and the point itself, for what is left.
"""

from __future__ import annotations

import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.recon.adam import KnotAdam
from splatreel.recon.spline import Spline

DIMENSIONS = 7
"""dx, and dq less its identity."""


class Trajectory:
    """See `Deformation`. Control values are stored as [knots, rows, 7] in units of `unit`, the typical viewing distance."""

    NODE_COUNTS = (64,)
    RATES = (5e-4, 1.5e-4)
    """Learning rates of the levels, the points' own last."""
    EXTRAPOLATION = 0.8

    def __init__(self, means: Tensor, frames: int, unit: float, seed: int = 0, tracks: Tensor | None = None) -> None:
        device = means.device
        paths = None if tracks is None else (tracks - means) / unit
        self.spline = Spline(frames) if paths is None else Spline.along(paths)
        self.knots = self.spline.knots
        self.reached = 3 if paths is None else self.knots - 1
        self.scale = torch.tensor([unit] * 3 + [1.0] * 4, device=device)
        self.identity = torch.tensor([1.0, 0, 0, 0], device=device)
        self.nodes = [means[farthest_points(means, count, seed)] for count in self.NODE_COUNTS if count < len(means)]
        self.skins = [skin(means, nodes) for nodes in self.nodes]
        rows = [len(nodes) for nodes in self.nodes] + [len(means)]
        controls = [torch.zeros(self.knots, n, DIMENSIONS, device=device) for n in rows]
        if paths is not None:  # the points' own level takes the tracks, as the smoothest spline close to them
            controls[-1][..., :3] = self.spline.fit(paths)
        self.rates = self.RATES[-len(rows) :]
        self.adams = [KnotAdam(level, rate, eps=1e-12) for level, rate in zip(controls, self.rates, strict=True)]

    @property
    def controls(self) -> list[Tensor]:
        """Of every level, the points' own last, [knots, rows, 7]."""
        return [adam.values for adam in self.adams]

    def offsets(self, means: Tensor, frame: float) -> tuple[Tensor, Tensor]:
        knot, weights = self.spline.at(frame)
        window = [adam.window(knot) for adam in self.adams]
        total = splat.splines(window, 0, weights, self.skins) * self.scale
        dx, dq = total.split((3, 4), 1)
        return dx, dq + self.identity

    def reach(self, frame: float) -> None:
        needed = self.spline.at(frame)[0] + 3
        with torch.no_grad():
            while self.reached < needed:
                self.reached += 1
                k = self.reached
                for controls in self.controls:
                    controls[k] = controls[k - 1] + self.EXTRAPOLATION * (controls[k - 1] - controls[k - 2])

    def step(self, share: float) -> None:
        for adam, rate in zip(self.adams, self.rates, strict=True):
            adam.rate = rate * 0.05**share
            adam.step(end=self.reached + 1)  # the knots after it have never been seen, and stay zero

    def keep(self, index: Tensor) -> None:
        self.skins = [(i[index], s[index]) for i, s in self.skins]
        self.adams[-1].rewrite(lambda rows: rows[:, index], lambda rows: rows[:, index])

    def append(self, means: Tensor, parents: Tensor | None) -> None:
        """Newcomers start with what makes their total offset zero: they were static."""
        added = [skin(means, nodes) for nodes in self.nodes]
        self.skins = [
            (torch.cat([i, ai]), torch.cat([s, as_])) for (i, s), (ai, as_) in zip(self.skins, added, strict=True)
        ]
        old = self.controls[-1]
        if parents is not None:
            rows = old[:, parents]
        else:
            rows = torch.zeros(self.knots, len(means), DIMENSIONS, device=means.device)
            for (index, share), controls in zip(added, self.controls[:-1], strict=True):
                rows -= torch.einsum("nk,tnkd->tnd", share, controls[:, index])
        state = torch.zeros_like(rows)
        self.adams[-1].rewrite(lambda t: torch.cat([t, rows], 1), lambda t: torch.cat([t, state], 1))


def farthest_points(points: Tensor, count: int, seed: int) -> Tensor:
    """Indices [count] of points spread evenly: each is the one farthest from those before it."""
    chosen = torch.empty(count, dtype=torch.int64, device=points.device)
    distance = torch.full((len(points),), torch.inf, device=points.device)
    current = seed % len(points)
    for i in range(count):
        chosen[i] = current
        distance = torch.minimum(distance, (points - points[current]).square().sum(1))
        current = int(distance.argmax())
    return chosen


def skin(points: Tensor, nodes: Tensor) -> tuple[Tensor, Tensor]:
    """The four nearest nodes of every point, [N, 4], and their weights [N, 4], which sum to one."""
    index, distance = splat.nearest_neighbours(nodes, min(4, len(nodes)), queries=points)
    width = distance[:, -1].median().clamp_min(1e-9)
    weights = torch.exp(-2 * (distance / width) ** 2) + 1e-6
    return index, weights / weights.sum(1, keepdim=True)
