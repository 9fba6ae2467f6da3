"""A term of the sum that training minimizes, and the state of an iteration that terms read and add gradients to.

The state includes an image of depths (`Depths`) and the nearest neighbors of points, which should move alike (paper section 4.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.kernels import rasterize, splat
from splatreel.kernels.binning import Bins
from splatreel.kernels.splat import Splats
from splatreel.method.deform.protocol import Deformation, Slope
from splatreel.method.train.render import View

MIN_ALPHA = 1e-3
"""Alpha below which a pixel shows nothing."""


@dataclass
class Depths:
    """Depths of a view. Only opacities and shapes of splats get gradients, so that misplaced points fade instead of moving.

    Attributes:
        moments: [H, W, 3] mean log depth over the near plane, its square and its cube.
        alpha: [H, W] opacity.
        d_first: [H, W] gradient to the mean, to which terms add.
        d_second: [H, W] gradient to the mean square, likewise.
    """

    moments: np.ndarray
    alpha: np.ndarray
    _bins: Bins
    _powers: np.ndarray
    _sums: np.ndarray
    d_first: np.ndarray = field(init=False)
    d_second: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        """Start with gradients of zero."""
        self.d_first, self.d_second = np.zeros_like(self.alpha), np.zeros_like(self.alpha)

    @staticmethod
    def of(splats: Splats, view: View, near: float, bins: Bins | None = None) -> Depths:
        """Draw the depths of splats. bins: the splats, sorted into tiles; None sorts them."""
        bins, powers = bins or splat.bin(splats, view.width, view.height), depth_powers(splats.depths, near)
        sums, alpha = rasterize.forward(bins, powers)
        shown = np.maximum(alpha, np.float32(MIN_ALPHA))
        return Depths(sums / shown[..., None], alpha, bins, powers, sums)

    def to_splats(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the gradients to the means2d [N, 2], conics [N, 3] and opacities [N] of the splats."""
        d_sums, d_alpha = self.to_drawing()
        found = rasterize.backward(self._bins, self._powers, self._sums, d_sums, self.alpha, d_alpha)
        return found.means2d, found.conics, found.opacities

    def to_drawing(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients to the blended powers of depths [H, W, 3] and to alpha [H, W]."""
        shown = np.maximum(self.alpha, np.float32(MIN_ALPHA))
        first, second, _ = (self.moments[..., k] for k in range(3))
        d_sums = np.stack([self.d_first / shown, self.d_second / shown, np.zeros_like(first)], -1)
        d_alpha = -(d_sums[..., 0] * first + d_sums[..., 1] * second) * (self.alpha >= np.float32(MIN_ALPHA))
        return d_sums, d_alpha


def depth_powers(depths: np.ndarray, near: float) -> np.ndarray:
    """Return the log depths over the near plane, their squares and their cubes, [N, 3], of depths [N]."""
    depth = np.log(np.maximum(depths, np.float32(near)) / np.float32(near))
    square = depth * depth
    return np.stack([depth, square, square * depth], 1)


@dataclass(frozen=True)
class Neighbors:
    """The K nearest neighbors of N points, by rank.

    Attributes:
        index: [K, N] int64.
        closeness: [K, N], 1 where two points coincide.
    """

    index: np.ndarray
    closeness: np.ndarray

    @staticmethod
    def of(means: np.ndarray, count: int) -> Neighbors | None:
        """Find up to `count` neighbors for each of the means [N, 3]; return None for fewer than two points."""
        if len(means) < 2:
            return None
        index, distance = splat.nearest_neighbors(means, min(count, len(means) - 1))
        width = 2 * max(np.quantile(distance[:, -1], 0.5, method="lower"), np.float32(1e-9))
        closeness = np.exp(-((distance / width) ** 2))
        # An iteration uses one rank of all points.
        return Neighbors(np.ascontiguousarray(index.T), np.ascontiguousarray(closeness.T))


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


@dataclass(kw_only=True)
class Iteration:
    """Values of one iteration that terms read, and the gradients that they add to.

    Attributes:
        moment: Time of the image, in frames of the group; 0 for keyframes.
        target: [H, W, 3] uint8 training image.
        points: Unconstrained arrays by name, as in `TrainablePoints`; of a group also dx [N, 3] and dq [N, 4], the offsets at the
            moment.
        bins: The splats, sorted into tiles; None if only other splats were sorted with them.
        photometric: Photometric loss; None if it was not computed.
        image: [H, W, 3] drawing with background and color gain, 0..1; None unless a term of the iteration `reads_image`.
        gradients: Gradients to `points` by name, while `Term.add_to_points` runs.
        custom: Values and gradients that functions of a user returned, by the ids of their terms.
    """

    iteration: int
    share: float
    camera: int
    moment: float
    view: View
    near: float
    unit: float
    target: np.ndarray
    points: dict[str, np.ndarray]
    splats: Splats
    bins: Bins | None = None
    photometric: float | None = None
    image: np.ndarray | None = None
    d_image: np.ndarray | None = None
    gradients: dict[str, np.ndarray] = field(default_factory=dict)
    custom: dict[int, tuple[float, dict[str, np.ndarray]]] = field(default_factory=dict)
    _depths: Depths | None = field(default=None, init=False)

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.view.width * self.view.height

    @property
    def depths(self) -> Depths:
        """Depths of the view, drawn when first used."""
        if self._depths is None:
            self._depths = Depths.of(self.splats, self.view, self.near, self.bins)
        return self._depths

    def depth_gradients(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return the gradients of the terms of depths to the means2d, conics and opacities of the splats; None without such terms."""
        return None if self._depths is None else self._depths.to_splats()

    def add(self, name: str, gradient: np.ndarray) -> None:
        """Add to the gradient of an array of `points`. The sum is a new array, since some gradients share memory."""
        self.gradients[name] = self.gradients[name] + gradient


@dataclass(kw_only=True)
class GroupIteration(Iteration):
    """An iteration of a group.

    Attributes:
        neighbors: Nearest neighbors; None for fewer than two points.
        rank: Rank of the neighbor that rigidity compares each point with; None without this term.
        span: First and last frame that smoothness looks at, and a position 0..1 between them; None without this term.
        slopes: Gradients to the model of motion at other moments than that of the image.
    """

    deformation: Deformation
    neighbors: Neighbors | None
    rank: int | None
    span: tuple[int, int, float] | None
    slopes: list[Slope] = field(default_factory=list)


Seen = TypeVar("Seen", bound=Iteration, contravariant=True)


@dataclass(frozen=True)
class Term(Generic[Seen]):
    """One term of the sum that training minimizes.

    A term has a value, and adds the gradient of its value times a weight: to the drawing before the backward pass, or to the points
    after it.

    Attributes:
        weight: Field of `KeyframeConfig` or `GroupConfig` with the weight, 0 to turn the term off; None means 1.
        every: The term runs in iterations first, first + every and so on, with `every` times its weight.
        block: Number of successive iterations that `every` and `first` count as one. A CPU runs two iterations at a time, and both
            should take equally long.
        after: Share of training after which the term runs.
    """

    name: str
    weight: str | None = None
    every: int = 1
    first: int = 0
    block: int = 1
    after: float = 0.0

    wgsl: ClassVar[tuple[str, ...]] = ()
    """Kernels of GPUs that compute the gradient (`gpu/shaders`). Trainings with a term without kernels run on the CPU."""
    exact: ClassVar[bool] = True
    """True if the gradient is that of the value. Some terms hold a part of their value constant."""
    reads_image: ClassVar[bool] = False
    """True if the term reads `Iteration.image`, so that the whole image is drawn."""

    def weight_at(self, step: Moment, config: KeyframeConfig | GroupConfig) -> float:
        """Return the weight in an iteration; 0 if the term does not run."""
        if step.iteration // self.block % self.every != self.first or (self.after and step.share <= self.after):
            return 0.0
        return self.every * (1.0 if self.weight is None else getattr(config, self.weight))

    def value(self, seen: Seen) -> float:
        """Return the value without its weight."""
        raise NotImplementedError

    def add_to_drawing(self, seen: Seen, weight: float) -> None:
        """Add gradients to `seen.d_image` or `seen.depths`."""

    def add_to_points(self, seen: Seen, weight: float) -> None:
        """Add gradients to `seen.gradients`, or to the model of motion at other moments."""


Due = Sequence[tuple[Term[Any], float]]
"""Terms that run in an iteration, and their weights."""


def due_terms(terms: Sequence[Term[Any]], step: Moment, config: KeyframeConfig | GroupConfig) -> Due:
    """Return the terms of a list that run in an iteration, with their weights."""
    return [(term, weight) for term in terms if (weight := term.weight_at(step, config))]


def sum_of_weights(kind: type[Term[Any]], due: Due) -> float:
    """Return the sum of the weights of the terms of a kind."""
    return sum(weight for term, weight in due if type(term) is kind)


def reported_loss(seen: Iteration, due: Due) -> float:
    """Return the loss that training shows: the photometric loss, or the sum of all terms of a list without one."""
    if seen.photometric is not None:
        return seen.photometric
    return float(sum(weight * term.value(seen) for term, weight in due))
