"""Iterations of keyframes and groups with gsplat: points, images, views and static points on the device, and Adam."""

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
from splatreel.gsplat import drawing
from splatreel.gsplat.drawing import Frozen, Lens, Splats, freeze, rasterize, rasterize_among, splats_of
from splatreel.method.deform.appearance import LAMBDA, RATES, Appearance
from splatreel.method.deform.knot_adam import DECAYS, Adam, KnotAdam
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.train.losses import weight_of
from splatreel.method.train.programs import Draw, GroupState, KeyframeDraw, KeyframeState, Outcome
from splatreel.method.train.render import StaticCache
from splatreel.method.train.terms.opacity import Opacity
from splatreel.method.train.terms.photometric import LAMBDA_DSSIM, Photometric
from splatreel.method.train.terms.rigidity import Rigidity
from splatreel.method.train.terms.smoothness import Smoothness
from splatreel.method.train.terms.surfaces import Roughness, Spread
from splatreel.method.train.terms.term import Neighbors
from splatreel.method.train.terms.view_dependence import ViewDependence
from splatreel.method.train.trainable_points import NAMES, TrainablePoints
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import C0

IMAGES_SHARE = 0.6
"""Largest share of the free memory that images take. Training needs the rest."""
D = TypeVar("D", Draw, KeyframeDraw)


@dataclass
class Trained:
    """An array of the host that is trained on the device, with its moments. Steps are counted by the optimizer of the host."""

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
    """Points, images, views and static points on the device. D: a draw. See `programs.Program`."""

    def __init__(
        self, device: torch.device, points: TrainablePoints, static: StaticCache | None, images: TrainingImages
    ) -> None:
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

    def download(self, moments: bool = True) -> None:
        """See `Program`. This always copies the moments."""
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


KEYFRAME_TERMS = Photometric, Opacity, Spread, Roughness
"""Terms that this program computes."""


class GsplatKeyframeProgram(GsplatProgram[KeyframeDraw]):
    """Program of a keyframe, see `KeyframeProgram`."""

    def __init__(self, device: torch.device, state: KeyframeState) -> None:
        super().__init__(device, state.points, state.static, state.images)
        self._state = state

    @property
    def trained(self) -> list[Trained]:
        """All arrays that are trained."""
        return [*self.canonical, self._gains]

    def upload(self) -> None:
        """See `Program`."""
        super().upload()
        self._gains = Trained.of(self._state.gains.adam, self.device)
        self._distances = self._tensor(self._state.density.distances)[:, None]
        self._averages = [torch.zeros_like(one.parameter) for one in self.canonical]

    def give_meters(self) -> None:
        """See `Program`."""
        meter = self._state.density.meter
        meter.sum, meter.seen = self.meter.arrays()

    def averages(self) -> list[np.ndarray]:
        """See `KeyframeProgram`."""
        return [mean.cpu().numpy() for mean in self._averages]

    def _iterate(self, draw: KeyframeDraw) -> tuple[Tensor, Tensor]:
        place = self.images.of_iteration(draw.iteration)[1] + draw.camera
        lens, near = self.lens(place), self.images.near
        points = [one.leaf() for one in self.canonical]
        plain = splats_of(points, None, None, lens, near)
        learns = draw.whole and self._state.gains.enabled
        gain = self._gains.parameter[draw.camera].detach().clone().requires_grad_(learns)
        splats, factor = _with_gain(plain, lens, None if draw.whole and not learns else gain)
        splats = splats._replace(means2d=splats.means2d.clone())  # measured without the losses of surfaces
        measures = draw.metered and self._state.measures_absolute
        absolute = torch.zeros_like(splats.means2d, requires_grad=False) if measures else None
        frozen = self.frozen(place)
        drawn = rasterize(splats, lens, absolute) if frozen is None else rasterize_among(splats, frozen, lens)
        image = with_background(drawn[0], lens)
        target = self.target(draw, 0, image, factor)
        loss = drawing.photometric(image, target, LAMBDA_DSSIM, factor)

        total = loss
        kinds = Opacity, Spread, Roughness
        faint, before, bent = (weight_of(kind, self._state.losses, draw, self._state.config) for kind in kinds)
        if faint:
            total = total + faint * points[3].sigmoid().sum() / (lens.width * lens.height)
        if before or bent:
            unit = self.images.unit / near
            total = total + drawing.surfaces(plain, lens, near, target, before, bent, unit)
        leaves = [*points, *([gain] if learns else [])]
        gradients = torch.autograd.grad(total, [*leaves, splats.means2d], materialize_grads=True)
        if draw.metered:
            self.meter.add(gradients[-1] if absolute is None else absolute, lens)
        self._follow(draw, gradients, learns)
        return loss.detach(), torch.zeros((), device=self.device)

    @torch.no_grad()
    def _follow(self, draw: KeyframeDraw, gradients: tuple[Tensor, ...], learns: bool) -> None:
        """Take the optimizer steps, and add to the running mean."""
        means = self.canonical[0].parameter
        before = means.clone()
        adam([Slope(*each) for each in zip(self.canonical, gradients, draw.rates, strict=False)])
        means.copy_(torch.lerp(before, means, self._distances))
        if self.images.opposite is not None:
            self.canonical[4].parameter.clamp_(-0.5 / C0, 0.5 / C0)
        if learns:
            slope = torch.zeros_like(self._gains.parameter)
            slope[draw.camera] = gradients[6]
            adam([Slope(self._gains, slope, self._gains.host.rate)])
            self._gains.parameter.div_(self._gains.parameter.mean(0))
        if draw.average:
            for mean, one in zip(self._averages, self.canonical, strict=True):
                mean.lerp_(one.parameter, draw.average)


def _with_gain(splats: Splats, lens: Lens, gain: Tensor | None) -> tuple[Splats, Tensor | None]:
    """Return the splats to draw, and the factor [3] on the drawing, for a camera's color gain [3]; None is 1.

    A background without a gain was divided by the gain that was known when the view was made. The splats then carry the rest of
    the gain, so that the gain is learned from them alone.
    """
    if lens.gain is None or gain is None:
        return splats, gain
    behind = 0.0 if lens.background is None else lens.background
    return splats._replace(colors=(splats.colors + behind) * (gain / lens.gain) - behind), lens.gain


GROUP_TERMS = Photometric, Rigidity, Smoothness, ViewDependence
"""Terms that this program computes."""


class GsplatGroupProgram(GsplatProgram[Draw]):
    """Program of a group, see `GroupProgram`."""

    def __init__(self, device: torch.device, state: GroupState) -> None:
        super().__init__(device, state.points.canonical, state.density.static, state.images)
        self.neighbors: Neighbors | None = None
        self.learns_time = state.learns_time
        self._state = state
        assert isinstance(state.points.deformation, Trajectory)
        self._model = state.points.deformation

    @property
    def trained(self) -> list[Trained]:
        """All arrays that are trained."""
        return [*self.canonical, *self._levels, *([] if self._shades is None else [self._shades])]

    def upload(self) -> None:
        """See `Program`."""
        super().upload()
        model, appearance, density = self._model, self._state.points.appearance, self._state.density
        self._levels = [Trained.of(level, self.device) for level in model.adams]
        self._shades = None if appearance is None else Trained.of(appearance.adam, self.device)
        self._skin = self._tensor(model.skin[0]), self._tensor(model.skin[1])
        self._moves = self._tensor(model.moves)
        self._gains = self._tensor(self._state.gains.values)
        self._near = None
        if self.neighbors is not None:
            self._near = self._tensor(self.neighbors.index), self._tensor(self.neighbors.closeness)
        self._prices, self._rates = (torch.tensor(each, device=self.device) for each in (LAMBDA, RATES))
        self._measured = self._tensor(density.convertible & density.static.alive)
        self._static_meter = Meter(len(density.static), self.device)

    def give_meters(self) -> None:
        """See `Program`."""
        density = self._state.density
        density.moving_meter.sum, density.moving_meter.seen = self.meter.arrays()
        density.static_meter.sum, density.static_meter.seen = self._static_meter.arrays()

    def _iterate(self, draw: Draw) -> tuple[Tensor, Tensor]:
        place = self.images.of_iteration(draw.iteration)[1] + draw.camera
        lens, pixels = self.lens(place), self.lens(place).width * self.lens(place).height
        self._extend_to(draw.last)
        points = [one.leaf() for one in self.canonical]
        moved = self._offsets(draw.moment, leaves=True)
        shade = self._shade_at(draw.moment)
        splats = splats_of(points, moved, shade, lens, self.images.near)
        image, seen, index = self._draw(draw, place, lens, splats)
        gain = self._gains[draw.camera]
        config, unit = self._state.config, self.images.unit
        target = self.target(draw, draw.frame, image, gain)
        loss = drawing.photometric(image, target, LAMBDA_DSSIM, gain)

        total = loss
        bands, rigid, smooth = (
            weight_of(kind, self._state.losses, draw, config) for kind in (ViewDependence, Rigidity, Smoothness)
        )
        if draw.rank is not None and self._near is not None:
            other, closeness = self._near[0][draw.rank], rigid * self._near[1][draw.rank]
            total = total + drawing.rigidity(points[0].detach(), *moved, other, closeness, unit)
        leaves = [*points, *moved, *([] if shade is None else [shade])]
        gradients = torch.autograd.grad(total, [*leaves, seen], materialize_grads=True)
        if bands and points[5].numel():
            gradients[5].add_(points[5].detach().sign(), alpha=bands / pixels)
        with torch.no_grad():
            return loss.detach(), self._follow(draw, lens, moved, shade, gradients, smooth, index)

    def _draw(self, draw: Draw, place: int, lens: Lens, splats: Splats) -> tuple[Tensor, Tensor, Tensor | None]:
        """Return the image, the screen positions that are measured, and the static points of those after the moving ones."""
        frozen = self.frozen(place)
        if frozen is None:
            return with_background(rasterize(splats, lens)[0], lens), splats.means2d, None
        if not draw.metered_static:
            return with_background(rasterize_among(splats, frozen, lens)[0], lens), splats.means2d, None
        both = Splats.join(splats, frozen.splats)
        return with_background(rasterize(both, lens)[0], lens), both.means2d, frozen.index

    def _follow(
        self,
        draw: Draw,
        lens: Lens,
        moved: tuple[Tensor, Tensor],
        shade: Tensor | None,
        gradients: tuple[Tensor, ...],
        smooth: float,
        index: Tensor | None,
    ) -> Tensor:
        """Measure, and take the optimizer steps. Return the time slope."""
        count = len(self._points)
        if draw.metered:
            self.meter.add(gradients[-1][:count], lens)
            if index is not None:
                chosen = self._measured[index, None]
                self._static_meter.add(gradients[-1][count:] * chosen, lens, index)
        d_dx, d_dq = gradients[6], gradients[7]
        slope = self._time_slope(draw.moment, d_dx, d_dq)
        levels = [torch.zeros_like(level.parameter) for level in self._levels]
        self._to_knots(levels, draw.moment, 1.0, d_dx, d_dq)
        if draw.span is not None:
            self._smoothness(levels, draw.span, smooth)

        late, names = draw.pace * 0.05**draw.share, self._points.adams
        rates = [self._points.base_rates[name] * draw.pace * 0.1**draw.share for name in names]
        steps = [Slope(*each) for each in zip(self.canonical, gradients, rates, strict=False)]
        end = self._model.reached + 1  # later knots have not been trained, and stay zero
        each = zip(self._levels, levels, self._model.RATES, strict=True)
        steps += [Slope(level, gradient, late * rate, end) for level, gradient, rate in each]
        if shade is not None and self._shades is not None:
            d_shade = (gradients[8] + shade.sign() * (self._prices / shade.numel())) * self._rates
            knot, weights = self._appearance.spline.at(draw.moment)
            total = torch.zeros_like(self._shades.parameter)
            for k, weight in enumerate(weights.tolist()):
                total[knot + k].add_(d_shade, alpha=weight)
            steps.append(Slope(self._shades, total, late))
        adam(steps)
        return slope

    @property
    def _appearance(self) -> Appearance:
        found = self._state.points.appearance
        assert found is not None
        return found

    def _shade_at(self, moment: float) -> Tensor | None:
        """Return the change of color and opacity at a moment, a leaf; None if appearance is fixed."""
        if self._shades is None:
            return None
        return (_spline(self._shades.parameter, *self._appearance.spline.at(moment)) * self._rates).requires_grad_()

    def _offsets(self, moment: float, leaves: bool = False) -> tuple[Tensor, Tensor]:
        """Return dx [N, 3] and dq [N, 4] at a moment. leaves: their gradients are wanted."""
        nodes, points = (_spline(level.parameter, *self._model.spline.at(moment)) for level in self._levels)
        index, share = self._skin
        total = points + (nodes[index] * share[..., None]).sum(1)
        dx, dq = self.model_unit * total[:, :3], torch.cat([total[:, 3:4] + 1, total[:, 4:]], 1)
        return dx.requires_grad_(leaves), dq.requires_grad_(leaves)

    @property
    def model_unit(self) -> float:
        """Length of one unit of the control values, world units."""
        return self._model.unit

    def _to_knots(self, levels: list[Tensor], moment: float, factor: float, d_dx: Tensor, d_dq: Tensor) -> None:
        """Add the gradients to the control values of nodes and points, of a factor times the offsets at a moment."""
        index, share = self._skin
        to_points = torch.cat([self.model_unit * d_dx, d_dq], 1)
        spread = (share[..., None] * to_points[:, None]).flatten(0, 1)
        to_nodes = to_points.new_zeros(levels[0].shape[1], 7).index_add_(0, index.flatten(), spread)
        knot, weights = self._model.spline.at(moment)
        for k, weight in enumerate(weights.tolist()):
            levels[0][knot + k].add_(to_nodes, alpha=factor * weight)
            levels[1][knot + k].add_(to_points * self._moves, alpha=factor * weight)

    def _smoothness(self, levels: list[Tensor], span: tuple[int, int, float], weight: float) -> None:
        """Add the gradients of `terms.smoothness` at its three moments, which are multiples of one gradient."""
        start, end, between = span
        moments = (1 - between, start), (between, end), (-1.0, start + between * (end - start))
        found = [[factor * part for part in self._offsets(moment)] for factor, moment in moments]
        bent, turned = (first + last + middle for first, last, middle in zip(*found, strict=True))
        share = weight / len(bent)
        d_dx, d_dq = bent.sign() * (share / self.model_unit), turned.sign() * share
        for factor, moment in moments:
            self._to_knots(levels, moment, factor, d_dx, d_dq)

    def _time_slope(self, moment: float, d_dx: Tensor, d_dq: Tensor) -> Tensor:
        """Return the gradient [] of the loss by the time of the image, per frame; 0 if it is not learned."""
        if not self.learns_time:
            return torch.zeros((), device=self.device)
        before, after = max(moment - 0.5, 0.0), min(moment + 0.5, self.images.count - 1.0)
        (dx0, dq0), (dx1, dq1) = self._offsets(before), self._offsets(after)
        return (((dx1 - dx0) * d_dx).sum() + ((dq1 - dq0) * d_dq).sum()) / (after - before)

    @torch.no_grad()
    def _extend_to(self, frame: float) -> None:
        """Extrapolate the control values that no earlier frame used, as `Trajectory.extend_to`."""
        model = self._model
        needed = model.spline.at(frame)[0] + 3
        while model.reached < needed:
            model.reached += 1
            k = model.reached
            for controls in (level.parameter for level in self._levels):
                controls[k] = controls[k - 1] + model.EXTRAPOLATION * (controls[k - 1] - controls[k - 2])


@torch.no_grad()
def _spline(controls: Tensor, knot: int, weights: np.ndarray) -> Tensor:
    """Return the values [R, D] of splines at one moment. A copy of the weights to the device would wait for it."""
    first, *others = weights.tolist()
    value = first * controls[knot]
    for k, weight in enumerate(others, 1):
        value = torch.add(value, controls[knot + k], alpha=weight)
    return value
