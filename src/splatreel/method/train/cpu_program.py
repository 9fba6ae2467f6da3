"""Iterations on the CPU: a fixed order of kernels, and two draws at a time."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np

from splatreel.base import threads
from splatreel.base.errors import GaussiansError
from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.method.train.losses import Terms
from splatreel.method.train.programs import Draw, KeyframeDraw, Outcome
from splatreel.method.train.terms.photometric import Compared
from splatreel.method.train.terms.term import Due, Iteration, due_terms
from splatreel.method.train.training_images import TrainingImages

TOGETHER = 2
"""Draws whose gradients are computed at the same time, from the same state. Optimizer steps follow in turn. It does not depend on the
number of cores, so that results do not either."""

D = TypeVar("D", Draw, KeyframeDraw)
G = TypeVar("G")


class CpuProgram(ABC, Generic[D, G]):
    """Program on the CPU, see `Program`. The state is that of the host. D: a draw. G: all gradients of a draw.

    Attributes:
        images: Images in use.
    """

    def __init__(self, images: TrainingImages, losses: Terms, config: GroupConfig | KeyframeConfig) -> None:
        """Prepare a program; `upload` follows."""
        self.images = images
        self._losses = losses
        self._config = config

    def upload(self) -> None:
        """Do nothing: the state is that of the host."""

    def run(self, draws: Sequence[D]) -> list[Outcome]:
        """See `Program`."""
        found: list[Outcome] = []
        while (first := len(found)) < len(draws):
            found += self._run_together(draws[first : first + self.together(draws[first])])
        return found

    def together(self, draw: D) -> int:
        """Return the number of draws, this one first, that start from the same state. Functions of a user run one at a time."""
        return 1 if any(term.reads_image for term in self._losses) else TOGETHER

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

    def due(self, draw: D) -> Due:
        """Return the terms that run in a draw, with their weights."""
        return due_terms(self._losses, draw, self._config)

    def _run_together(self, draws: Sequence[D]) -> list[Outcome]:
        """Run draws from one state, each on its share of the threads if they draw different views."""
        places = [self.prepare(draw) for draw in draws]
        found: list[G] = [None] * len(draws)  # type: ignore[list-item]

        def compute(first: int, last: int) -> None:
            with threads.divided(len(draws)):
                for k in range(first, last):
                    found[k] = self.gradients(draws[k], places[k])

        # Draws of one view use the same frozen splats, one after the other.
        threads.run_ranges(compute, len(draws), (), chunks=len(set(places)))
        return [self.follow(draw, place, one) for draw, place, one in zip(draws, places, found, strict=True)]


def check_loss(loss: float, splats: Sequence[np.ndarray]) -> None:
    """Check a loss, and the values of splats that get gradients.

    Raises:
        GaussiansError: One is NaN or infinite.
    """
    if not math.isfinite(loss + float(sum(part.sum() for part in splats))):
        raise GaussiansError(f"the training error is {loss}, or a splat is not finite")


def splat_gradients(compared: Compared, seen: Iteration, due: Due) -> list[np.ndarray]:
    """Return the gradients to means2d, conics, colors and opacities of `seen.splats`, of the image and of its depths.

    Args:
        compared: Gradients of the image, of these splats and perhaps of others after them.
        seen: The iteration.
        due: Terms that run in it.
    """
    found = [part[: len(seen.splats.means2d)] for part in compared.splats]
    for term, weight in due:
        if not term.reads_image:
            term.add_to_drawing(seen, weight)
    if (depths := seen.depth_gradients()) is not None:
        for place, part in zip((0, 1, 3), depths, strict=True):
            found[place] = found[place] + part
    return found
