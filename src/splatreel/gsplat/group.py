"""Iterations of a group with gsplat."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from splatreel.gsplat import losses
from splatreel.gsplat.drawing import Lens, Splats, rasterize, rasterize_among, splats_of
from splatreel.gsplat.program import GsplatProgram, Meter, Slope, Trained, adam, with_background
from splatreel.method.deform.appearance import LAMBDA, RATES, Appearance
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.train.losses import LAMBDA_DSSIM, weight_of
from splatreel.method.train.programs import Draw, GroupState
from splatreel.method.train.regularizers import Neighbors
from splatreel.method.train.terms.photometric import Photometric
from splatreel.method.train.terms.rigidity import Rigidity
from splatreel.method.train.terms.smoothness import Smoothness
from splatreel.method.train.terms.view_dependence import ViewDependence

TERMS = Photometric, Rigidity, Smoothness, ViewDependence
"""Terms that this program computes."""


class GsplatGroupProgram(GsplatProgram[Draw]):
    """Program of a group, see `Program`.

    Attributes:
        neighbors: Nearest neighbors; None for fewer than two points.
        learns_time: Slopes of the time offsets are measured.
    """

    def __init__(self, device: torch.device, state: GroupState) -> None:
        """Prepare a program; `upload` follows."""
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
        """Run one iteration."""
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
        loss = losses.photometric(image, target, LAMBDA_DSSIM, gain)

        total = loss
        bands, rigid, smooth = (
            weight_of(kind, self._state.losses, draw, config) for kind in (ViewDependence, Rigidity, Smoothness)
        )
        if draw.rank is not None and self._near is not None:
            other, closeness = self._near[0][draw.rank], rigid * self._near[1][draw.rank]
            total = total + losses.rigidity(points[0].detach(), *moved, other, closeness, unit)
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
