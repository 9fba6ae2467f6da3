"""What training minimizes: one list for keyframes, one for groups.

A new loss is a function of the step and its weight in this file, a line in a list, and a field for its weight in the configuration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.recon.train.moving import Changes, MovingPoints
from splatreel.recon.train.points import TrainablePoints
from splatreel.recon.train.regularizers import Neighbors, arap, temporal
from splatreel.recon.train.render import Comparable, Splats, View
from splatreel.recon.train.surfaces import Depths, roughness, spread


@dataclass(frozen=True, kw_only=True)
class Step:
    """What one iteration has drawn, and the picture that it should equal. share: 0..1, how much of training is over.

    target: [H, W, 3] uint8. gain: [3] of the camera's channels, or None.
    """

    iteration: int
    share: float
    view: View
    drawing: Comparable
    target: Tensor
    gain: Tensor | None
    lambda_dssim: float
    unit: float

    @property
    def pixels(self) -> int:
        return self.view.width * self.view.height


@dataclass(frozen=True, kw_only=True)
class KeyframeStep(Step):
    """splats: the points as the view sees them. near: near plane, world units."""

    points: TrainablePoints
    splats: Splats
    near: float

    @cached_property
    def depths(self) -> Depths:
        """What depth the view shows, drawn when the first loss asks for it."""
        return Depths.of(self.splats, self.view, self.near)


@dataclass(frozen=True, kw_only=True)
class GroupStep(Step):
    """changes: of the points, at the moment that was drawn. frame: that was drawn, of `frames`. last: the last one let in so far.

    rng: of what losses draw by lot.
    """

    points: MovingPoints
    changes: Changes
    neighbors: Neighbors | None
    frame: int
    frames: int
    last: int
    rng: np.random.Generator


S = TypeVar("S", bound=Step, contravariant=True)


@dataclass(frozen=True)
class Loss(Generic[S]):
    """One term of the sum that training minimizes.

    cost: of a step and the weight, the weighted scalar, or None where there is nothing to compare.
    weight: the field of `KeyframeConfig` or `GroupConfig` that has it, 0 to turn the loss off; without a field it is 1.
    every, first: it runs in the iterations first, first + every and so on, and counts `every` times there: the mean is the same.
    after: share of training from which on it runs.
    on_gradients: it needs no graph. `cost` runs after the backward pass, adds the gradient itself and returns None.
    """

    name: str
    cost: Callable[[S, float], Tensor | None]
    weight: str | None = None
    every: int = 1
    first: int = 0
    after: float = 0.0
    on_gradients: bool = False

    def weight_at(self, step: S, config: KeyframeConfig | GroupConfig) -> float:
        """What it counts in this step; 0 if it does not run."""
        if step.iteration % self.every != self.first or (self.after and step.share <= self.after):
            return 0.0
        return self.every * (1.0 if self.weight is None else getattr(config, self.weight))


def backward(losses: Sequence[Loss[S]], step: S, config: KeyframeConfig | GroupConfig) -> dict[str, Tensor]:
    """Leaves the gradients of the losses' sum. Returns the losses that ran, by name; not those on gradients."""
    weighted = [(loss, weight) for loss in losses if (weight := loss.weight_at(step, config))]
    costs = {loss.name: loss.cost(step, weight) for loss, weight in weighted if not loss.on_gradients}
    found = {name: cost for name, cost in costs.items() if cost is not None}
    torch.autograd.backward(list(found.values()))
    for loss, weight in weighted:
        if loss.on_gradients:
            loss.cost(step, weight)
    return found


def photometric(step: Step, _weight: float) -> Tensor:
    """How much the drawing differs from the picture (3DGS): absolute differences, and structural similarity."""
    return step.drawing.loss(step.target, step.lambda_dssim, step.gain)


def opacity(step: KeyframeStep, weight: float) -> Tensor:
    """The sum of all opacities, a pixel: what explains little fades, floaters first."""
    return weight * step.points.opacities.sum() / step.pixels


def before_surfaces(step: KeyframeStep, weight: float) -> Tensor:
    """What lies before the surface that a pixel shows."""
    return weight * spread(step.depths)


def bent_surfaces(step: KeyframeStep, weight: float) -> Tensor:
    """Bends in depth where the picture is plain."""
    return weight * roughness(step.depths, step.target, step.unit / step.near)


def rigidity(step: GroupStep, weight: float) -> Tensor | None:
    """L_arap of every point with one of its neighbors, of the same random rank for all."""
    if step.neighbors is None:
        return None
    rank = int(step.rng.integers(len(step.neighbors.index)))
    other, weights = step.neighbors.index[rank], weight * step.neighbors.closeness[rank]
    return arap(step.points.means, step.changes.dx, step.changes.dq, other, weights, step.unit)


def smoothness(step: GroupStep, weight: float) -> Tensor | None:
    """L_temp from the frame that was drawn to one up to TEMPORAL_WINDOW frames later, and a random moment between the two."""
    start = min(step.frame, max(step.last - TEMPORAL_WINDOW, 0))
    end = min(start + TEMPORAL_WINDOW, step.last)
    if step.frames < 3 or end <= start:
        return None
    delta = float(step.rng.uniform())
    return weight * temporal(step.points.deformation, step.points.means, start, end, delta, step.unit)


def view_dependence(step: GroupStep, weight: float) -> None:
    """The sizes of the higher SH bands, summed, a pixel. Their gradient is a sign: it is added to what is there."""
    step.points.canonical.price_sh(weight / step.pixels)


TEMPORAL_WINDOW = 2
"""Frames over which motion is to be smooth: the paper's number (section 5.1)."""

GROWTH = 0.6
"""Share of a keyframe's iterations in which points are added; from then on opacities cost something: earlier, that hinders growth."""
SURFACES_FROM = 0.4
"""Share of a keyframe's iterations from which on its surfaces are looked at: earlier, they are not there yet."""

KEYFRAME: tuple[Loss[KeyframeStep], ...] = (
    Loss("photometric", photometric),
    Loss("opacity", opacity, "lambda_opacity", after=GROWTH),
    Loss("bent surfaces", bent_surfaces, "lambda_roughness", every=2, after=SURFACES_FROM),
    Loss("before surfaces", before_surfaces, "lambda_spread", every=2, after=SURFACES_FROM),
)
CHAPTER_KEYFRAME: tuple[Loss[KeyframeStep], ...] = (
    Loss("photometric", photometric),
    Loss("opacity", opacity, "lambda_opacity", after=GROWTH),
)
"""Of many new points before static ones: what explains little fades. Surfaces are those of bodies, which are seen from all around."""
KEYFRAME_BEFORE_STATIC: tuple[Loss[KeyframeStep], ...] = (Loss("photometric", photometric),)
"""Of points before static ones nothing else is asked: what moves has few points, and needs them."""

GROUP: tuple[Loss[GroupStep], ...] = (
    Loss("photometric", photometric),
    Loss("rigidity", rigidity, "lambda_arap", every=2),
    Loss("smoothness", smoothness, "lambda_temporal", every=8, first=1),
    Loss("view dependence", view_dependence, "lambda_sh", on_gradients=True),
)
"""The changes of colors and opacities have their price in `Appearance.step`, on the spline that they are values of."""


def psnr(image: Tensor, target: Tensor) -> float:
    """dB of an image [H, W, 3] against its target, uint8."""
    error = (image.clamp(0, 1) - target.float() / 255).square().mean()
    return -10 * math.log10(max(float(error), 1e-12))
