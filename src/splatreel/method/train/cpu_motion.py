"""Motion and appearance of a group's points on the CPU, as arrays: their values at a moment, and gradients to their splines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import arrays
from splatreel.kernels.adam import Step
from splatreel.method.deform.appearance import LAMBDA, RATES
from splatreel.method.deform.trajectory import Slopes, Trajectory
from splatreel.method.train.cpu_program import array
from splatreel.method.train.dynamic_points import DynamicPoints
from splatreel.method.train.programs import Draw
from splatreel.method.train.regularizers import Neighbors

PRICES, SHADE_RATES = np.array(LAMBDA, np.float32), np.array(RATES, np.float32)
FIXED = np.zeros((0, 4), np.float32)
"""Shade of points whose appearance is fixed."""


class Moment(NamedTuple):
    """Changes of N points at a moment, see `dynamic_points.Changes`. shade [N, 4] has no rows if appearance is fixed."""

    time: float
    dx: np.ndarray
    dq: np.ndarray
    shade: np.ndarray


class CpuMotion:
    """Splines of motion and appearance. Between `catch_up` and `steps`, methods only read, so that threads can share the object."""

    def __init__(self, points: DynamicPoints, frames: int, learns_time: bool) -> None:
        """Refer to the splines of some points.

        Args:
            points: The points.
            frames: Number of frames of the group.
            learns_time: Whether `time_slope` is used.
        """
        assert isinstance(points.deformation, Trajectory)
        self._model, self._appearance = points.deformation, points.appearance
        self._means = array(points.means)
        self._skin = array(self._model.skin[0]), array(self._model.skin[1])
        self._moves = array(self._model.moves)
        self._frames, self._learns_time = frames, learns_time

    def catch_up(self, draw: Draw) -> None:
        """Take the deferred optimizer steps of all knots that a draw reads."""
        times = [draw.moment, *(self._neighborhood(draw.moment) if self._learns_time else ())]
        if draw.span is not None:
            start, end, _ = draw.span
            times += [start, end]
        knots = [self._model.spline.at(time)[0] for time in times]
        for level in self._model.adams:
            level.current(min(knots), max(knots) + 4)
        if self._appearance is not None:
            knot = self._appearance.spline.at(draw.moment)[0]
            self._appearance.adam.current(knot, knot + 4)

    def at(self, time: float) -> Moment:
        """Return the changes at a time, in frames of the group."""
        dx, dq = self._offsets(time)
        if self._appearance is None:
            return Moment(time, dx, dq, FIXED)
        knot, weights = self._appearance.spline.at(time)
        shade = arrays.spline(array(self._appearance.adam.tensor)[knot : knot + 4], weights)
        shade *= SHADE_RATES
        return Moment(time, dx, dq, shade)

    def slopes(self, d_dx: np.ndarray, d_dq: np.ndarray) -> tuple[Tensor, Tensor]:
        """Return the gradients [M, 7] and [N, 7] to the splines of nodes and points, from the gradients to dx and dq."""
        nodes, points = arrays.offsets_gradient(d_dx, d_dq, self._skin, len(self._model.nodes), self._model.unit)
        points *= self._moves
        return torch.from_numpy(nodes), torch.from_numpy(points)

    def rigidity(self, moment: Moment, neighbors: Neighbors, rank: int, weight: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients of `losses.rigidity` to dx and dq."""
        other, closeness = array(neighbors.index[rank]), np.float32(weight) * array(neighbors.closeness[rank])
        return arrays.arap(self._means, moment.dx, moment.dq, other, closeness, self._model.unit)[1:]

    def smoothness(self, span: tuple[int, int, float], weight: float) -> list[Slopes]:
        """Return the gradients of `losses.smoothness` at its three moments, which are multiples of one gradient."""
        start, end, between = span
        times = (1 - between, start), (between, end), (-1.0, start + between * (end - start))
        bent, turned = (np.zeros_like(self._means), np.zeros((len(self._means), 4), np.float32))
        for factor, time in times:
            dx, dq = self._offsets(time)
            bent += np.float32(factor) * dx
            turned += np.float32(factor) * dq
        share = weight / len(self._means)
        d_dx, d_dq = np.zeros_like(bent), np.zeros_like(turned)
        arrays.add_signs(bent, np.full(3, share / self._model.unit, np.float32), d_dx)
        arrays.add_signs(turned, np.full(4, share, np.float32), d_dq)
        slopes = self.slopes(d_dx, d_dq)
        knots = [(factor, *self._model.spline.at(time)) for factor, time in times]
        return [(knot, np.float32(factor) * weights, slopes) for factor, knot, weights in knots]

    def time_slope(self, time: float, slopes: tuple[Tensor, Tensor]) -> float:
        """Return the gradient of the loss by the time of the image, per frame; see `time_offsets.slope`."""
        before, after = self._neighborhood(time)
        (first, early), (last, late) = self._model.spline.at(before), self._model.spline.at(after)
        weights = np.zeros(last + 4 - first, np.float32)
        weights[last - first :] += late
        weights[:4] -= early
        levels = [array(level.tensor)[first : last + 4] for level in self._model.adams]
        changes = (arrays.product_sum(one, weights, array(slope)) for one, slope in zip(levels, slopes, strict=True))
        return sum(changes) / (after - before)

    def steps(self, draw: Draw, moment: Moment, known: list[Slopes], d_shade: np.ndarray) -> list[Step]:
        """Return the optimizer steps of all splines.

        Args:
            draw: The draw.
            moment: Its moment.
            known: Gradients to the splines of motion.
            d_shade: [N, 4] gradient to the shade, without its price. It is changed.
        """
        found = self._model.follow(known, draw.share, draw.pace)
        if self._appearance is not None:
            arrays.add_signs(moment.shade, PRICES / np.float32(moment.shade.size), d_shade)
            d_shade *= SHADE_RATES
            slopes = (*self._appearance.spline.at(draw.moment), torch.from_numpy(d_shade))
            found += self._appearance.follow([slopes], draw.share, draw.pace)
        return found

    def knots(self, time: float) -> tuple[int, np.ndarray]:
        """Return the first of the four knots that determine the motion at a time, and their weights."""
        return self._model.spline.at(time)

    def _offsets(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return dx [N, 3] and dq [N, 4] at a time."""
        knot, weights = self._model.spline.at(time)
        nodes, points = (array(level.tensor)[knot : knot + 4] for level in self._model.adams)
        return arrays.offsets(nodes, points, weights, self._skin, self._model.unit)

    def _neighborhood(self, time: float) -> tuple[float, float]:
        """Return the times between which the motion is compared for `time_slope`."""
        return max(time - 0.5, 0.0), min(time + 0.5, self._frames - 1.0)
