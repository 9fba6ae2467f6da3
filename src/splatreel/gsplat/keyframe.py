"""Iterations of a keyframe with gsplat."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from splatreel.gsplat import losses
from splatreel.gsplat.drawing import Lens, Splats, rasterize, rasterize_among, splats_of
from splatreel.gsplat.program import GsplatProgram, Slope, Trained, adam, with_background
from splatreel.method.train.losses import LAMBDA_DSSIM, weight_of
from splatreel.method.train.programs import KeyframeDraw, KeyframeState
from splatreel.method.train.terms.opacity import Opacity
from splatreel.method.train.terms.photometric import Photometric
from splatreel.method.train.terms.surfaces import Roughness, Spread
from splatreel.scene.gaussians import C0

TERMS = Photometric, Opacity, Spread, Roughness
"""Terms that this program computes."""


class GsplatKeyframeProgram(GsplatProgram[KeyframeDraw]):
    """Program of a keyframe, see `KeyframeProgram`."""

    def __init__(self, device: torch.device, state: KeyframeState) -> None:
        """Prepare a program; `upload` follows."""
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
        """Run one iteration."""
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
        loss = losses.photometric(image, target, LAMBDA_DSSIM, factor)

        total = loss
        kinds = Opacity, Spread, Roughness
        faint, before, bent = (weight_of(kind, self._state.losses, draw, self._state.config) for kind in kinds)
        if faint:
            total = total + faint * points[3].sigmoid().sum() / (lens.width * lens.height)
        if before or bent:
            unit = self.images.unit / near
            total = total + losses.surfaces(plain, lens, near, target, before, bent, unit)
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
