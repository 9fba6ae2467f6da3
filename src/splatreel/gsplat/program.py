"""Parts that the programs of groups and keyframes share: points, images, views and static points on the device, and Adam."""

# pyright: reportPrivateImportUsage=false
# (torch documents `_foreach_mul_` and its like, and its own optimizers use them, but the names are not exported)

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from splatreel.base.errors import GaussiansError, GpuError
from splatreel.gsplat.drawing import Frozen, Lens, freeze, splats_of
from splatreel.method.deform.knot_adam import DECAYS, Adam, KnotAdam
from splatreel.method.train.programs import Draw, KeyframeDraw, Outcome
from splatreel.method.train.render import StaticCache
from splatreel.method.train.trainable_points import NAMES, TrainablePoints
from splatreel.method.train.training_images import TrainingImages

IMAGES_SHARE = 0.6
"""Largest share of the free memory that images take. Training needs the rest."""
D = TypeVar("D", Draw, KeyframeDraw)


@dataclass
class Trained:
    """An array of the host that is trained on the device, with its moments.

    Attributes:
        host: Optimizer of the host, whose steps are counted there.
        parameter, mean, square: Tensors of the shape of the host's arrays.
    """

    host: Adam
    parameter: Tensor
    mean: Tensor
    square: Tensor

    @staticmethod
    def of(host: Adam, device: torch.device) -> Trained:
        """Copy an optimizer of the host, with all its steps, to the device."""
        parameter = host.values if isinstance(host, KnotAdam) else host.parameter
        return Trained(host, *(torch.tensor(each, device=device) for each in (parameter, host.mean, host.square)))

    def leaf(self) -> Tensor:
        """Return the values as a leaf of a graph."""
        return self.parameter.detach().requires_grad_()

    def download(self) -> None:
        """Copy the values and moments to the host."""
        for array, tensor in zip(
            (self.host.parameter, self.host.mean, self.host.square),
            (self.parameter, self.mean, self.square),
            strict=True,
        ):
            array[...] = tensor.cpu().numpy()


@dataclass(frozen=True)
class Slope:
    """A gradient of an array, and the learning rate of its step. Rows from `end` on do not change."""

    trained: Trained
    gradient: Tensor
    rate: float
    end: int | None = None


@torch.no_grad()
def adam(slopes: Sequence[Slope]) -> None:
    """Take a step of Adam for each array. Lists of tensors need few calls, which is what takes time on a GPU."""
    parameters, means, squares = (
        [getattr(slope.trained, name)[: slope.end] for slope in slopes] for name in ("parameter", "mean", "square")
    )
    gradients = [slope.gradient[: slope.end] for slope in slopes]
    for slope in slopes:
        slope.trained.host.steps += 1
    numbers, epsilons = zip(*((slope.trained.host.steps, slope.trained.host.eps) for slope in slopes), strict=True)
    decay, square_decay = DECAYS
    torch._foreach_mul_(means, decay)
    torch._foreach_mul_(squares, square_decay)
    torch._foreach_add_(means, gradients, alpha=1 - decay)
    torch._foreach_addcmul_(squares, gradients, gradients, 1 - square_decay)
    denominators = torch._foreach_sqrt(squares)
    torch._foreach_div_(denominators, [math.sqrt(1 - square_decay**number) for number in numbers])
    torch._foreach_add_(denominators, epsilons)
    lengths = [-slope.rate / (1 - decay**number) for slope, number in zip(slopes, numbers, strict=True)]
    torch._foreach_addcdiv_(parameters, means, denominators, lengths)


class Meter:
    """Lengths of the screen-space gradients of points, see `density.GradientMeter`."""

    def __init__(self, count: int, device: torch.device) -> None:
        """Start with no views of `count` points."""
        self.sum, self.seen = (torch.zeros(count, device=device) for _ in range(2))

    def add(self, gradient: Tensor, lens: Lens, index: Tensor | None = None) -> None:
        """Add the gradients [M, 2] of one view. index: [M] points of the rows; None is all points."""
        length = torch.hypot(gradient[:, 0] * (lens.width / 2), gradient[:, 1] * (lens.height / 2))
        if index is None:
            self.sum += length
            self.seen += length > 0
        else:
            self.sum.index_add_(0, index, length)
            self.seen.index_add_(0, index, (length > 0).float())

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the sums and the numbers of views."""
        return self.sum.cpu().numpy(), self.seen.cpu().numpy()


class GsplatProgram(ABC, Generic[D]):
    """Points, images, views and static points on the device. D: a draw. See `programs.Program`.

    Attributes:
        images: Images in use.
        device: Device of the tensors.
    """

    def __init__(
        self, device: torch.device, points: TrainablePoints, static: StaticCache | None, images: TrainingImages
    ) -> None:
        """Prepare a program; `upload` follows."""
        self.device = device
        self.images = images
        self._points = points
        self._static = static
        self._pool: OrderedDict[tuple[int, int], tuple[Tensor, Tensor | None]] = OrderedDict()
        self._pool_of: TrainingImages | None = None
        self._lenses: dict[int, Lens] = {}
        self._frozen: dict[int, Frozen] = {}
        self._still: list[Tensor] = []
        self._shown = b""
        self._losses: list[Tensor] = []

    @property
    def trained(self) -> list[Trained]:
        """All arrays that are trained."""
        return self.canonical

    def upload(self) -> None:
        """See `Program`."""
        if self._pool_of is not self.images:
            for kept in (self._pool, self._lenses, self._frozen):
                kept.clear()
            self._pool_of = self.images
            free = torch.cuda.mem_get_info(self.device)[0]
            *_, height, width, _ = self.images.pixels.shape
            self._fit = max(int(IMAGES_SHARE * free) // (3 * width * height), 1)
        if self._static is not None and (shown := self._static.alive.tobytes()) != self._shown:
            self._shown = shown
            self._frozen.clear()
        self.canonical = [Trained.of(one, self.device) for one in self._points.adams.values()]
        self.meter = Meter(len(self._points), self.device)

    def download(self) -> None:
        """See `Program`."""
        for one in self.trained:
            one.download()

    def run(self, draws: Sequence[D]) -> list[Outcome]:
        """See `Program`. Results are read once for all draws, since reading waits for the device."""
        try:
            found = torch.stack([torch.stack(self._iterate(draw)) for draw in draws]).cpu().tolist()
        except torch.OutOfMemoryError as error:
            raise GpuError(f"CUDA: the device has too little memory: {error}") from error
        for loss, _ in found:
            if not math.isfinite(loss):
                raise GaussiansError(f"the training error is {loss}")
        return [Outcome(*one) for one in found]

    @abstractmethod
    def _iterate(self, draw: D) -> tuple[Tensor, Tensor]:
        """Run one iteration. Return its loss [] and its time slope []."""

    def lens(self, place: int) -> Lens:
        """Return a view of `images.all_views`."""
        if place not in self._lenses:
            view = self.images.all_views[place]
            pose, K, center = (self._tensor(array) for array in (view.viewmat, view.K, view.center))
            back, gain = (None if a is None else self._tensor(a) for a in (view.background, view.gain))
            size = view.width, view.height
            self._lenses[place] = Lens(pose, K, center, *size, view.antialias, view.clear, back, gain)
        return self._lenses[place]

    @torch.no_grad()
    def frozen(self, place: int) -> Frozen | None:
        """Return the living static points that a view sees; None if there are none."""
        if self._static is None or len(self._static) == 0:
            return None
        if place not in self._frozen:
            if not self._still:
                self._still = [self._tensor(self._static.params[name]) for name in NAMES]
            lens, index = self.lens(place), self._tensor(np.flatnonzero(self._static.alive))
            near = max(self.images.near, lens.clear)
            projected = splats_of([part[index] for part in self._still], None, None, lens, near)
            seen = torch.nonzero(projected.radii > 0)[:, 0]
            self._frozen[place] = freeze(projected.rows(seen), index[seen], lens)
        return self._frozen[place]

    def target(self, draw: D, frame: int, drawn: Tensor, gain: Tensor | None) -> Tensor:
        """Return the target image [H, W, 3] uint8 of a draw. Unknown pixels repeat the drawing, so that they cause no loss."""
        shown, first = self.images.of_iteration(draw.iteration)
        key = frame, first + draw.camera
        if key in self._pool:
            self._pool.move_to_end(key)
        else:
            while len(self._pool) >= self._fit:
                self._pool.popitem(last=False)
            unknown = None if shown.unknown is None else self._tensor(shown.unknown[frame, draw.camera])
            self._pool[key] = self._tensor(shown.pixels[frame, draw.camera]), unknown
        image, unknown = self._pool[key]
        if unknown is None:
            return image
        drawn = drawn.detach() if gain is None else drawn.detach() * gain.detach()
        return torch.where(unknown[..., None], (drawn.clamp(0, 1) * 255).round().to(torch.uint8), image)

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.tensor(np.ascontiguousarray(array), device=self.device)


def with_background(image: Tensor, lens: Lens) -> Tensor:
    """Add the background to an image that was blended relative to it."""
    return image if lens.background is None else image + lens.background
