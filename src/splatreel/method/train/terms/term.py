"""A term of the sum that training minimizes, and the state of an iteration that terms read and add gradients to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.kernels.binning import Bins
from splatreel.kernels.splat import Splats
from splatreel.method.deform.protocol import Deformation, Slope
from splatreel.method.train.regularizers import Neighbors
from splatreel.method.train.render import View
from splatreel.method.train.terms.depths import Depths


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
        iteration: Number of the iteration.
        share: Share of training that is over, 0..1.
        camera: Number of the camera.
        moment: Time of the image, in frames of the group; 0 for keyframes.
        view: View that was drawn.
        near: Near plane, world units.
        unit: Typical viewing distance, world units.
        target: [H, W, 3] uint8 training image.
        points: Unconstrained arrays by name, as in `TrainablePoints`; of a group also dx [N, 3] and dq [N, 4], the offsets at the
            moment.
        splats: The points, projected to the view.
        bins: The splats, sorted into tiles; None if only other splats were sorted with them.
        photometric: Photometric loss; None if it was not computed.
        image: [H, W, 3] drawing with background and color gain, 0..1; None unless a term of the iteration `reads_image`.
        d_image: Gradient to `image`.
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
        deformation: Model of motion.
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
        name: Name in messages.
        weight: Field of `KeyframeConfig` or `GroupConfig` with the weight, 0 to turn the term off; None means 1.
        every: The term runs in iterations first, first + every and so on, with `every` times its weight.
        first: See `every`.
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
