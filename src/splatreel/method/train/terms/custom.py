"""A user's own loss: a function on arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar

import numpy as np

from splatreel.base.errors import UsageError
from splatreel.method.train.render import View
from splatreel.method.train.terms.term import Iteration, Term


@dataclass(frozen=True)
class Seen:
    """Input of a loss function. All arrays are copies.

    Attributes:
        points: Points by name: means [N, 3], quats [N, 4] wxyz of any length, log_scales [N, 3], logit_opacities [N], sh_base
            [N, 1, 3] and sh_rest [N, K - 1, 3]. While a group is trained also dx [N, 3] and dq [N, 4], the change of means and quats
            at the moment of the image. All are float32.
        image: Drawing as the camera would take it, [H, W, 3] float32, 0..1.
        target: Training image, [H, W, 3] uint8.
        camera: Number of the camera.
        view: Pose and lens of the camera at the size of the images.
        moment: Time of the image, in frames of the group; 0 while a keyframe is trained.
        iteration: Number of the iteration.
        share: Share of training that is over, 0..1.
    """

    points: Mapping[str, np.ndarray]
    image: np.ndarray
    target: np.ndarray
    camera: int
    view: View
    moment: float
    iteration: int
    share: float


LossFunction = Callable[[Seen], tuple[float, Mapping[str, np.ndarray]]]
"""Function that returns a value, and its gradients by name: to `image`, or to any of `Seen.points`. Names may be left out."""


@dataclass(frozen=True)
class Custom(Term[Iteration]):
    """A function of a user, added to the other terms with a weight of one.

    Attributes:
        function: The function. It runs once in an iteration.
    """

    function: LossFunction = field(kw_only=True)

    reads_image: ClassVar[bool] = True

    def value(self, seen: Iteration) -> float:
        """See `Term`."""
        return seen.custom[id(self)][0]

    def add_to_drawing(self, seen: Iteration, weight: float) -> None:
        """See `Term`."""
        assert seen.image is not None
        arrays = {name: array.copy() for name, array in seen.points.items()}
        image = seen.image.copy(), np.array(seen.target), seen.camera, seen.view
        value, gradients = self.function(Seen(arrays, *image, seen.moment, seen.iteration, seen.share))
        shapes = {"image": seen.image.shape} | {name: array.shape for name, array in seen.points.items()}
        checked = {name: self._checked(name, gradient, shapes) for name, gradient in gradients.items()}
        seen.custom[id(self)] = float(value), checked
        if "image" in checked and seen.d_image is not None:
            seen.d_image += np.float32(weight) * checked["image"]

    def add_to_points(self, seen: Iteration, weight: float) -> None:
        """See `Term`."""
        for name, gradient in seen.custom[id(self)][1].items():
            if name != "image":
                seen.add(name, np.float32(weight) * gradient)

    def _checked(self, name: str, gradient: Any, shapes: Mapping[str, tuple[int, ...]]) -> np.ndarray:
        """Return a gradient as float32.

        Raises:
            UsageError: There is nothing of this name, or it has another shape.
        """
        if name not in shapes:
            raise UsageError(f"The loss {self.name} returns a gradient of {name!r}. It may return {', '.join(shapes)}.")
        found = np.asarray(gradient, np.float32)
        if found.shape != shapes[name]:
            raise UsageError(
                f"The loss {self.name} returns a gradient of {name} with shape {found.shape}, expected {shapes[name]}."
            )
        return found


T = TypeVar("T", bound=Term[Any])


def with_functions(terms: Sequence[T], functions: Sequence[LossFunction]) -> Sequence[T | Custom]:
    """Return a list of terms with functions of a user added.

    Raises:
        UsageError: One is not a function.
    """
    for function in functions:
        if not callable(function):
            raise UsageError(f"A loss is {function!r:.60}. Give a function from `Seen` to a value and gradients.")
    named = [getattr(function, "__name__", type(function).__name__) for function in functions]
    return [*terms, *(Custom(name, function=one) for name, one in zip(named, functions, strict=True))]
