"""Losses of training: one list for keyframes, one for groups.

A new loss is a function in this file, a line in a list, and a field for its weight in the configuration. The kernels of programs
(`programs.py`) have their own arithmetic of some of these functions. Lists with other functions are trained with torch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, Protocol, TypeAlias, TypeVar

import numpy as np
import torch
from torch import Tensor

from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.kernels.projected import Splats
from splatreel.method.train.dynamic_points import Changes, DynamicPoints
from splatreel.method.train.regularizers import Depths, Neighbors, arap, roughness, spread, temporal
from splatreel.method.train.render import Comparable, View
from splatreel.method.train.trainable_points import TrainablePoints


@dataclass(frozen=True, kw_only=True)
class Step:
    """Drawing of one iteration and its target image.

    Attributes:
        iteration: Number of the iteration.
        share: Share of training that is over, 0..1.
        view: View that was drawn.
        drawing: The drawing.
        target: [H, W, 3] uint8.
        gain: [3] color gain of the camera; None is 1.
        lambda_dssim: Weight of structural similarity in the photometric loss.
        unit: Typical viewing distance, world units.
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
        """Number of pixels."""
        return self.view.width * self.view.height


@dataclass(frozen=True, kw_only=True)
class KeyframeStep(Step):
    """An iteration of a keyframe.

    Attributes:
        points: Trained points.
        splats: The points, projected to the view.
        near: Near plane, world units.
    """

    points: TrainablePoints
    splats: Splats
    near: float

    @cached_property
    def depths(self) -> Depths:
        """Depths of the view, drawn when first used."""
        return Depths.of(self.splats, self.view, self.near)


@dataclass(frozen=True, kw_only=True)
class GroupStep(Step):
    """An iteration of a group.

    Attributes:
        points: Trained points.
        changes: Changes of the points at the moment that was drawn.
        neighbors: Nearest neighbors; None for fewer than two points.
        frame: Frame that was drawn.
        frames: Number of frames.
        last: Last frame that the schedule may draw so far.
        rng: Source of random choices.
    """

    points: DynamicPoints
    changes: Changes
    neighbors: Neighbors | None
    frame: int
    frames: int
    last: int
    rng: np.random.Generator


class Moment(Protocol):
    """Number of an iteration, and the share of training that is over before it."""

    @property
    def iteration(self) -> int:
        """Number of the iteration."""
        ...

    @property
    def share(self) -> float:
        """Share of training that is over, 0..1."""
        ...


S = TypeVar("S", bound=Step, contravariant=True)
Cost: TypeAlias = Callable[[S, float], Tensor | None]
"""Function of a loss, see `Loss.cost`."""


@dataclass(frozen=True)
class Loss(Generic[S]):
    """One term of the sum that training minimizes.

    Attributes:
        name: Name in the result of `backward`.
        cost: Function from a step and a weight to the weighted scalar; None if there is nothing to compare.
        weight: Field of `KeyframeConfig` or `GroupConfig` with the weight, 0 to turn the loss off; None means 1.
        every: The loss runs in iterations first, first + every and so on, with `every` times its weight.
        first: See `every`.
        block: Number of successive iterations that `every` and `first` count as one. A CPU runs two iterations at a time, and both
            should take equally long.
        after: Share of training after which the loss runs.
        on_gradients: `cost` runs after the backward pass, adds to the gradients itself and returns None.
    """

    name: str
    cost: Cost[S]
    weight: str | None = None
    every: int = 1
    first: int = 0
    block: int = 1
    after: float = 0.0
    on_gradients: bool = False

    def weight_at(self, step: Moment, config: KeyframeConfig | GroupConfig) -> float:
        """Return the weight in a step; 0 if the loss does not run."""
        if step.iteration // self.block % self.every != self.first or (self.after and step.share <= self.after):
            return 0.0
        return self.every * (1.0 if self.weight is None else getattr(config, self.weight))


def backward(losses: Sequence[Loss[S]], step: S, config: KeyframeConfig | GroupConfig) -> dict[str, Tensor]:
    """Compute the gradients of the sum of the losses.

    Returns:
        The losses that ran, by name, without those on gradients.
    """
    weighted = [(loss, weight) for loss in losses if (weight := loss.weight_at(step, config))]
    costs = [(loss.name, loss.cost(step, weight)) for loss, weight in weighted if not loss.on_gradients]
    found = [(name, cost) for name, cost in costs if cost is not None]
    torch.autograd.backward([cost for _, cost in found])
    for loss, weight in weighted:
        if loss.on_gradients:
            loss.cost(step, weight)
    return dict(found)


def reported_loss(found: dict[str, Tensor]) -> Tensor:
    """Return the loss [] that training shows: the photometric loss, or the sum of a list without one."""
    loss = found.get("photometric")
    return torch.stack(list(found.values())).sum().detach() if loss is None else loss.detach()


def weight_of(
    cost: Cost[S],
    losses: Sequence[Loss[S]],
    step: Moment,
    config: KeyframeConfig | GroupConfig,
) -> float:
    """Return the weight in a step of all losses of a list that have a function; 0 if none runs."""
    return sum(loss.weight_at(step, config) for loss in losses if loss.cost is cost)


def photometric(step: Step, _weight: float) -> Tensor:
    """Return the photometric loss of 3DGS: absolute differences and structural similarity."""
    return step.drawing.loss(step.target, step.lambda_dssim, step.gain)


def opacity(step: KeyframeStep, weight: float) -> Tensor:
    """Return the sum of all opacities per pixel. Points that explain little fade, floaters first."""
    return weight * step.points.opacities.sum() / step.pixels


def before_surfaces(step: KeyframeStep, weight: float) -> Tensor:
    """Return the loss of points in front of the surface that a pixel shows."""
    return weight * spread(step.depths)


def bent_surfaces(step: KeyframeStep, weight: float) -> Tensor:
    """Return the loss of bends in depth where the image is plain."""
    return weight * roughness(step.depths, step.target, step.unit / step.near)


def choose_rank(neighbors: Neighbors, rng: np.random.Generator) -> int:
    """Return the random rank of the neighbor that `rigidity` compares each point with."""
    return int(rng.integers(len(neighbors.index)))


def choose_span(frame: int, frames: int, last: int, rng: np.random.Generator) -> tuple[int, int, float] | None:
    """Return two frames for `smoothness` and a random position 0..1 between them; None if there are too few frames.

    Args:
        frame: Frame that was drawn.
        frames: Number of frames.
        last: Last frame that the schedule may draw so far.
        rng: Source of the position.
    """
    start = min(frame, max(last - TEMPORAL_WINDOW, 0))
    end = min(start + TEMPORAL_WINDOW, last)
    return None if frames < 3 or end <= start else (start, end, float(rng.uniform()))


def rigidity(step: GroupStep, weight: float) -> Tensor | None:
    """Return L_arap of every point with one of its neighbors, of the same random rank for all points."""
    if step.neighbors is None:
        return None
    rank = choose_rank(step.neighbors, step.rng)
    other, weights = step.neighbors.index[rank], weight * step.neighbors.closeness[rank]
    return arap(step.points.means, step.changes.dx, step.changes.dq, other, weights, step.unit)


def smoothness(step: GroupStep, weight: float) -> Tensor | None:
    """Return L_temp between the drawn frame and one up to TEMPORAL_WINDOW frames later."""
    span = choose_span(step.frame, step.frames, step.last, step.rng)
    return None if span is None else weight * temporal(step.points.deformation, step.points.means, *span, step.unit)


def view_dependence(step: GroupStep, weight: float) -> None:
    """Add the gradient of the L1 norm of the higher SH bands per pixel."""
    step.points.canonical.price_sh(weight / step.pixels)


LAMBDA_DSSIM = 0.2
"""Weight of structural similarity in the photometric loss of keyframes, as in 3DGS."""
TEMPORAL_WINDOW = 2
"""Frames over which motion should be smooth; the paper's value (section 5.1)."""

GROWTH = 0.6
"""Share of a keyframe's iterations in which points are added. Opacities cost something only after that, since it hinders
growth."""
SURFACES_FROM = 0.4
"""Share of a keyframe's iterations after which the losses of surfaces run. Earlier there are no surfaces yet."""

KEYFRAME: tuple[Loss[KeyframeStep], ...] = (
    Loss("photometric", photometric),
    Loss("opacity", opacity, "lambda_opacity", after=GROWTH),
    Loss("bent surfaces", bent_surfaces, "lambda_roughness", every=2, block=2, after=SURFACES_FROM),
    Loss("before surfaces", before_surfaces, "lambda_spread", every=2, block=2, after=SURFACES_FROM),
)
CHAPTER_KEYFRAME: tuple[Loss[KeyframeStep], ...] = (
    Loss("photometric", photometric),
    Loss("opacity", opacity, "lambda_opacity", after=GROWTH),
)
"""Losses of new points in front of static ones. The losses of surfaces do not apply: new content is seen from all around."""
KEYFRAME_BEFORE_STATIC: tuple[Loss[KeyframeStep], ...] = (Loss("photometric", photometric),)
"""Losses of a later keyframe. Moving content has few points and needs all of them, so opacity costs nothing."""

GROUP: tuple[Loss[GroupStep], ...] = (
    Loss("photometric", photometric),
    Loss("rigidity", rigidity, "lambda_arap", every=2),
    Loss("smoothness", smoothness, "lambda_temporal", every=8, first=1),
    Loss("view dependence", view_dependence, "lambda_sh", on_gradients=True),
)
"""Losses of a group. Changes of colors and opacities are regularized in `Appearance.step`, on the values of their spline."""


def psnr(image: Tensor, target: Tensor) -> float:
    """Return the PSNR, dB, of an image [H, W, 3] against its target, uint8."""
    error = (image.clamp(0, 1) - target.float() / 255).square().mean()
    return -10 * math.log10(max(float(error), 1e-12))
