"""Iterations on the CPU: a fixed order of kernels, without autograd, and two draws at a time.

With autograd, torch and Python take a third of an iteration, on one core while the others wait.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from splatreel.base import threads
from splatreel.base.errors import GaussiansError
from splatreel.kernels import arrays
from splatreel.method.train.programs import Draw, KeyframeDraw, Outcome
from splatreel.method.train.render import View
from splatreel.method.train.training_images import TrainingImages

TOGETHER = 2
"""Draws whose gradients are computed at the same time, from the same state. Optimizer steps follow in turn. It does not depend on the
number of cores, so that results do not either."""

D = TypeVar("D", Draw, KeyframeDraw)
G = TypeVar("G")


class Seen(NamedTuple):
    """A view of the training images as the kernels take it. background: [3]; None is black."""

    view: View
    pinhole: arrays.Pinhole
    center: np.ndarray
    background: np.ndarray | None


class CpuProgram(ABC, Generic[D, G]):
    """Program on the CPU, see `Program`. The state is that of the host. D: a draw. G: all gradients of a draw.

    Attributes:
        images: Images in use.
    """

    def __init__(self, images: TrainingImages) -> None:
        """Prepare a program; `upload` follows."""
        self.images = images
        self._views: dict[int, Seen] = {}

    def upload(self) -> None:
        """Refer to the arrays of the host."""
        self._views.clear()

    def run(self, draws: Sequence[D]) -> list[Outcome]:
        """See `Program`."""
        found: list[Outcome] = []
        with torch.no_grad():
            while (first := len(found)) < len(draws):
                found += self._run_together(draws[first : first + self.together(draws[first])])
        return found

    def together(self, draw: D) -> int:
        """Return the number of draws, this one first, that start from the same state."""
        return TOGETHER

    def give_meters(self) -> None:
        """Do nothing: each draw gives its gradients."""

    def download(self) -> None:
        """Do nothing: the state is that of the host."""

    @abstractmethod
    def prepare(self, draw: D) -> int:
        """Compute what draws share. Return the place of a draw's view in `images.all_views`."""

    @abstractmethod
    def gradients(self, draw: D, place: int) -> G:
        """Draw, compare, and compute all gradients. This only reads the state.

        Raises:
            GaussiansError: The loss or a splat is NaN or infinite.
        """

    @abstractmethod
    def follow(self, draw: D, place: int, found: G) -> Outcome:
        """Take the optimizer steps of a draw, and give its gradients to density control."""

    def _run_together(self, draws: Sequence[D]) -> list[Outcome]:
        """Run draws from one state, each on its share of the threads if they draw different views."""
        places = [self.prepare(draw) for draw in draws]
        found: list[G] = [None] * len(draws)  # type: ignore[list-item]

        def compute(first: int, last: int) -> None:
            with torch.no_grad(), threads.divided(len(draws)):
                for k in range(first, last):
                    found[k] = self.gradients(draws[k], places[k])

        # Draws of one view use the same frozen splats, one after the other.
        threads.run_ranges(compute, len(draws), (), chunks=len(set(places)))
        return [self.follow(draw, place, one) for draw, place, one in zip(draws, places, found, strict=True)]

    def seen(self, place: int) -> Seen:
        """Return a view of `images.all_views` as the kernels take it."""
        if place not in self._views:
            view = self.images.all_views[place]
            blur = arrays.FINE_BLUR if view.antialias else arrays.BLUR
            lens = array(view.viewmat), array(view.K), view.width, view.height, self.images.near, blur
            background = None if view.background is None else array(view.background)
            self._views[place] = Seen(view, arrays.Pinhole(*lens), array(view.center), background)
        return self._views[place]


def check_loss(loss: float, splats: Sequence[np.ndarray]) -> None:
    """Check a loss, and the values of splats that get gradients.

    Raises:
        GaussiansError: One is NaN or infinite.
    """
    if not math.isfinite(loss + float(sum(part.sum() for part in splats))):
        raise GaussiansError(f"the training error is {loss}, or a splat is not finite")


def array(tensor: Tensor) -> np.ndarray:
    """Return an array that shares the memory of a tensor on the CPU."""
    return tensor.detach().numpy()
