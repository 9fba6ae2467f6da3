"""Which points a group has: conversion of static points (paper 4.1), cloning (4.2), and pruning of what hardly shows."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from splatreel.config import Config
from splatreel.config.layering import PAPER_WIDTH
from splatreel.kernels import splat
from splatreel.motion.lift import NEIGHBORS
from splatreel.recon.train.density import CULL_OPACITY, GradientMeter, too_large
from splatreel.recon.train.moving import MovingPoints
from splatreel.recon.train.pictures import Pictures
from splatreel.recon.train.render import Comparable, StaticCache, View, contributions, relative_distances

CONVERT_FROM, CONVERT_TO = 0.25, 0.8
"""Share of training in which points are converted and cloned: before, everything that moves pulls; after, none could learn."""

LEAST_BUDGET = 2000
"""Points that a group may gain in all, or half of those that it starts with."""

FAINT_AT = (0.4, 0.7)
"""Shares of training after which the faintest points go: what guessed the wrong place has faded by then, and the rest can fill in."""

FAINT_PICTURES = 60
"""Pictures in which that is measured."""

MEASURE_EVERY = 8
"""Iterations between two that measure how much the static points are pulled at: they draw these too."""


class GroupDensity:
    """Changes the rows of `points` and what is alive of `static`. convertible: [S] bool, the static points that may become dynamic.

    budget: points that may still be added. rng: picks the cameras by which faint points are found.
    """

    def __init__(
        self,
        points: MovingPoints,
        static: StaticCache,
        convertible: Tensor,
        config: Config,
        iterations: int,
        rng: np.random.Generator,
    ) -> None:
        self.points, self.static, self.convertible, self.config, self.rng = points, static, convertible, config, rng
        self.every, self.iterations = config.layering.adapt_every, iterations
        self.faint_at = {round(share * iterations) for share in FAINT_AT} if config.group.faint_share else set()
        self.budget = max(LEAST_BUDGET, len(points) // 2)
        self.restart()

    def restart(self) -> None:
        """Begin to measure anew, after points have come or gone."""
        device = self.points.means.device
        self.moving_meter = GradientMeter(len(self.points), device)
        self.static_meter = GradientMeter(len(self.static), device)

    def measured_static(self, iteration: int) -> Tensor | None:
        """[S] bool: the static points that an iteration shall measure the pull at; None: it looks only at what moves."""
        due = self._measures(iteration) and iteration % MEASURE_EVERY == 0
        return self.convertible & self.static.alive if due else None

    def measure(self, iteration: int, drawing: Comparable, view: View) -> None:
        """How an iteration pulls at the points, after its backward pass."""
        if not self._measures(iteration):
            return
        grad = drawing.means2d.grad
        assert grad is not None
        self.moving_meter.add(grad[: drawing.moving], view.width, view.height)
        if drawing.index is not None:
            self.static_meter.add(grad[drawing.moving :], view.width, view.height, drawing.index)

    def update(self, done: int, pictures: Pictures) -> bool:
        """After `done` iterations: let points come and go where it is time for it. Returns whether it was."""
        due, faint_due = self.every > 0 and done % self.every == 0, done in self.faint_at
        if due or faint_due:
            self.points.check()
        if due and self._converts(done):
            self.convert_and_clone(pictures)
        if due:
            self.prune(pictures)
        if faint_due:
            self.drop_faint(pictures)
        if due or faint_due:
            self.restart()
        return due or faint_due

    def convert_and_clone(self, pictures: Pictures) -> None:
        """Adaptive static-point conversion (paper 4.1), then clone dynamic points that the images still pull at (4.2)."""
        layering, alive = self.config.layering, self.static.alive
        threshold = layering.adapt_gradient * (PAPER_WIDTH / pictures.views[0].width)
        pull_static, pull_moving = self.static_meter.mean(), self.moving_meter.mean()
        convert = alive & (pull_static > threshold) | alive & self._surrounded(alive)
        converted = self._within_budget(convert & self.convertible, pull_static)
        clones = self._within_budget(pull_moving > threshold, pull_moving)
        self.points.clone(clones)
        self.convert(converted)

    def convert(self, index: Tensor) -> None:
        """Make static points [M] int64 dynamic."""
        if len(index) == 0:
            return
        rows = {name: value[index] for name, value in self.static.params.items()}
        alive = self.static.alive.clone()
        alive[index] = False
        self.static.set_alive(alive)
        self.points.append(rows)

    def prune(self, pictures: Pictures) -> None:
        """Drop what hardly shows and what is absurdly large for where it is; far walls and trees are large, and would leave holes."""
        config, points = self.config.keyframe, self.points
        with torch.no_grad():
            keep = points.highest_logits().sigmoid() >= CULL_OPACITY
            distances = relative_distances(points.means, pictures.views, pictures.unit, config.far_step_scale)
            keep &= ~too_large(points.canonical.scales, distances, pictures.unit)
        if not bool(keep.all()):
            points.keep(torch.nonzero(keep)[:, 0])

    def drop_faint(self, pictures: Pictures) -> None:
        """Drop the points that together fill next to nothing of the pictures: often half of all, and each costs bytes and time."""
        total = torch.zeros(len(self.points), device=self.points.means.device)
        for k in range(FAINT_PICTURES):
            frame = k * (pictures.count - 1) // (FAINT_PICTURES - 1)
            camera = int(self.rng.integers(len(pictures.views)))
            view = pictures.views[camera]
            with torch.no_grad():
                splats = self.points.at(frame, view, pictures.near)
            total += contributions(splats, view, self.static.view(camera))
        order = total.argsort()
        held = total[order].cumsum(0) / total.sum().clamp_min(1e-9)
        self.points.keep(order[held >= self.config.group.faint_share].sort().values)

    def _converts(self, done: int) -> bool:
        return CONVERT_FROM <= done / self.iterations <= CONVERT_TO

    def _measures(self, iteration: int) -> bool:
        """Whether points are converted when this interval ends; what it measures is not used otherwise."""
        return self.every > 0 and self._converts((iteration // self.every + 1) * self.every)

    def _within_budget(self, chosen: Tensor, pull: Tensor) -> Tensor:
        """[M] int64 of a mask, those that are pulled at most if there are too many. They are taken off the budget."""
        index = torch.nonzero(chosen)[:, 0]
        if len(index) > self.budget:
            index = index[torch.topk(pull[index], self.budget).indices]
        self.budget -= len(index)
        return index

    def _surrounded(self, alive: Tensor) -> Tensor:
        """[S] bool: static points with more than lambda_adp^nn of their nearest neighbors dynamic."""
        index = torch.nonzero(alive)[:, 0]
        everything = torch.cat([self.static.means[index], self.points.means.detach()])
        k = min(NEIGHBORS, len(everything) - 1)
        surrounded = torch.zeros_like(alive)
        if len(index) and k > 0:
            neighbors = splat.nearest_neighbors(everything, k)[0][: len(index)]
            dynamic = (neighbors >= len(index)).float().mean(1)
            surrounded[index] = dynamic > self.config.layering.adapt_neighbors
        return surrounded
