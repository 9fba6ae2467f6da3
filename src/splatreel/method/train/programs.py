"""Programs that run whole iterations of training on the CPU or on a GPU, and what varies between iterations.

A trainer plans draws, with all random choices. A program executes them. The program of the CPU runs every list of terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.train.density import GroupDensity, KeyframeDensity
from splatreel.method.train.dynamic_points import DynamicPoints
from splatreel.method.train.losses import Terms
from splatreel.method.train.render import StaticCache
from splatreel.method.train.terms.photometric import Photometric
from splatreel.method.train.terms.surfaces import Roughness, Spread
from splatreel.method.train.terms.term import Neighbors
from splatreel.method.train.trainable_points import TrainablePoints
from splatreel.method.train.training_images import TrainingImages

MOST_DRAWS = 64
"""Largest number of draws of a batch."""


@dataclass(frozen=True)
class Draw:
    """All that varies between the iterations of a group.

    Attributes:
        share: Share of training that is over, 0..1.
        pace: Factor for the learning rates.
        last: Last frame that the schedule may draw so far.
        moment: Time of the image, in frames of the group.
        whole: The whole image is compared; otherwise the tiles that moving points touch.
        metered: The gradients of moving points are measured.
        metered_static: The gradients of static points are measured.
        rank: Rank of the neighbor that rigidity compares each point with; None without this loss.
        span: First and last frame that smoothness looks at, and a position 0..1 between them; None without this loss.
    """

    iteration: int
    share: float
    pace: float
    frame: int
    last: int
    camera: int
    moment: float
    whole: bool
    metered: bool
    metered_static: bool
    rank: int | None
    span: tuple[int, int, float] | None


@dataclass(frozen=True)
class KeyframeDraw:
    """All that varies between the iterations of a keyframe.

    Attributes:
        whole: The whole image is compared, and the color gains are learned.
        metered: The gradients of points are measured.
        average: Weight of the result in the running mean; 0 if the iteration is not a sample of it.
        rates: Learning rates of the attributes, in the order of `points.NAMES`.
    """

    iteration: int
    share: float
    camera: int
    whole: bool
    metered: bool
    average: float
    rates: tuple[float, ...]


class KeyframeState(NamedTuple):
    """Points, images and color gains that a program of a keyframe trains, and its settings."""

    points: TrainablePoints
    static: StaticCache | None
    density: KeyframeDensity
    images: TrainingImages
    config: KeyframeConfig
    losses: Terms
    gains: CameraGains

    @property
    def measures_absolute(self) -> bool:
        """True if density control measures absolute gradients."""
        return self.config.detail and self.static is None

    @property
    def unsupported_by_gpu(self) -> str | None:
        """Reason why the kernels of GPUs cannot train the keyframe; None if they can."""
        if self.static is not None and any(isinstance(term, Spread | Roughness) for term in self.losses):
            return "terms of surfaces do not look at static points"
        return terms_without_kernels(self.losses)


class GroupState(NamedTuple):
    """Points and images that a program of a group trains, and its settings. The gains stay fixed; `density` knows the static points."""

    points: DynamicPoints
    density: GroupDensity
    images: TrainingImages
    config: GroupConfig
    losses: Terms
    gains: CameraGains
    learns_time: bool

    @property
    def unsupported_by_gpu(self) -> str | None:
        """Reason why the kernels of GPUs cannot train the motion of the group; None if they can."""
        model = self.points.deformation
        if not isinstance(model, Trajectory):
            return "the hash grid is trained on the CPU only"
        if model.reached < model.knots - 1:
            return "groups without tracks are trained on the CPU or with CUDA"
        return terms_without_kernels(self.losses)


class Outcome(NamedTuple):
    """Result of a draw.

    Attributes:
        loss: Photometric loss, or the sum of all terms of a list without one.
        slope: Change of the loss per frame of the camera's time offset; 0 if it was not measured.
    """

    loss: float
    slope: float


def terms_without_kernels(losses: Terms) -> str | None:
    """Return why the kernels of GPUs cannot compute a list of terms; None if they can."""
    plain = [term for term in losses if isinstance(term, Photometric)]
    if len(plain) != 1 or plain[0] != Photometric(plain[0].name):
        return "the kernels do not compute the photometric loss other than once in every iteration"
    others = [term.name for term in losses if not term.wgsl]
    return f"the kernels do not compute the loss {', '.join(others)}" if others else None


D = TypeVar("D", contravariant=True)


class Program(Protocol[D]):
    """Iterations on a device. The state of the host is valid before `upload` and after `download`.

    Adam's moments of the points may stay on the device while rows change, see `TrainablePoints.origins`.
    """

    def upload(self) -> None:
        """Take over the state of the host, after its rows or the image size changed."""
        ...

    def run(self, draws: Sequence[D]) -> list[Outcome]:
        """Run iterations, and wait for their results.

        Raises:
            GaussiansError: A value is NaN or infinite.
            GpuError: The device was lost, or has too little memory.
        """
        ...

    def give_meters(self) -> None:
        """Give the measured gradients to density control."""
        ...

    def download(self, moments: bool = True) -> None:
        """Copy the state to the host. moments: those of the points too, which saving the state needs."""
        ...


class KeyframeProgram(Program[KeyframeDraw], Protocol):
    """Iterations of a keyframe."""

    def averages(self) -> list[np.ndarray]:
        """Return the running means of the points' parameters since `upload`, see `KeyframeDraw.average`."""
        ...


class GroupProgram(Program[Draw], Protocol):
    """Iterations of a group.

    Attributes:
        images: Images in use, set before `upload`.
        neighbors: Nearest neighbors, set before `upload`; None for fewer than two points.
    """

    images: TrainingImages
    neighbors: Neighbors | None
    learns_time: bool
