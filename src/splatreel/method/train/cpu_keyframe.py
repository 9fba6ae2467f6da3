"""Iterations of a keyframe on the CPU, without autograd."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import adam, arrays
from splatreel.method.train.cpu_program import CpuProgram, Seen, array, check_loss
from splatreel.method.train.cpu_surfaces import depth_powers, surface_gradients
from splatreel.method.train.hidden_colors import bound_colors
from splatreel.method.train.losses import (
    LAMBDA_DSSIM,
    Cost,
    KeyframeStep,
    before_surfaces,
    bent_surfaces,
    opacity,
    weight_of,
)
from splatreel.method.train.programs import KeyframeDraw, KeyframeState, Outcome
from splatreel.method.train.render import StaticView

FIXED = tuple(np.zeros((0, size), np.float32) for size in (3, 4, 4))
"""Changes of points that do not move."""


class _Compared(NamedTuple):
    """A drawing's loss, its gradients to the splats, the gradient [3] to the color gain, and what density control measures, [N, 2].

    gain is None for drawings of a part of the image.
    """

    loss: float
    splats: list[np.ndarray]
    gain: np.ndarray | None
    screen: np.ndarray


class _Gradients(NamedTuple):
    """Result of a draw: its comparison, and the gradients to the points."""

    compared: _Compared
    points: Sequence[np.ndarray]


class CpuKeyframeProgram(CpuProgram[KeyframeDraw, _Gradients]):
    """Program of a keyframe, see `KeyframeProgram`."""

    def __init__(self, state: KeyframeState) -> None:
        """Prepare a program; `upload` follows."""
        super().__init__(state.images)
        self._state = state

    def upload(self) -> None:
        """See `Program`."""
        super().upload()
        self._tensors = list(self._state.points.params.values())
        self._arrays = [array(tensor) for tensor in self._tensors]
        self._averages = [torch.zeros_like(tensor, requires_grad=False) for tensor in self._tensors]

    def together(self, draw: KeyframeDraw) -> int:
        """See `CpuProgram`. While points are added, each draw starts from the last one's state: pairs would add 4 % fewer points."""
        return 1 if draw.metered else super().together(draw)

    def averages(self) -> list[Tensor]:
        """See `KeyframeProgram`."""
        return self._averages

    def prepare(self, draw: KeyframeDraw) -> int:
        """See `CpuProgram`."""
        place = self.images.of_iteration(draw.iteration)[1] + draw.camera
        if self._state.static is not None:
            self._state.static.view(place)
        return place

    def gradients(self, draw: KeyframeDraw, place: int) -> _Gradients:
        """See `CpuProgram`."""
        camera, static = self.seen(place), self._state.static
        behind = None if static is None else static.view(place)
        points = arrays.DeformedPoints._make([*self._arrays, *FIXED])
        opacities, seen = arrays.deform(points, camera.center, camera.pinhole)
        tint, gain = self._gain(draw, camera)
        colors = seen.colors if tint is None else seen.colors * tint
        colors = colors if camera.background is None else colors - camera.background
        splats = seen.means2d, seen.conics, colors, opacities
        size = camera.view.width, camera.view.height
        bins = arrays.bin_splats(seen.means2d, seen.conics, opacities, seen.depths, seen.radii, *size)
        compare = self._compare_all if draw.whole else self._compare_tiles
        compared = compare(draw, camera, bins, colors, seen, behind, gain)
        check_loss(compared.loss, splats)
        if tint is not None:
            d_colors = compared.splats[2]
            if compared.gain is not None:
                compared = compared._replace(gain=(d_colors * seen.colors).sum(0) / gain)
            compared.splats[2] = d_colors * tint
        found = arrays.deform_gradient(points, seen, camera.center, camera.pinhole, *compared.splats)[:6]
        if price := self._weight(draw, opacity) / (size[0] * size[1]):
            found[3][:] += np.float32(price) * seen.opaque * (1 - seen.opaque)
        return _Gradients(compared, found)

    def _gain(self, draw: KeyframeDraw, camera: Seen) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Return the factor [3] on the colors of the points, and that on the drawing. None is 1.

        Their product is the color gain of the camera. If a background is known only together with a gain (`View.gain`), this part is on
        the drawing, and the points carry the rest.
        """
        gains, given = self._state.gains, camera.view.gain
        if draw.whole and not gains.enabled:
            return None, None
        gain = array(gains.values[draw.camera])
        return (None, gain) if given is None else (gain / array(given), array(given))

    def _compare_all(
        self,
        draw: KeyframeDraw,
        camera: Seen,
        bins: arrays.Bins,
        colors: np.ndarray,
        seen: arrays.ProjectedPoints,
        static: StaticView | None,
        gain: np.ndarray | None,
    ) -> _Compared:
        """Draw and compare the whole image."""
        shown = self.images.of_iteration(draw.iteration)[0]
        frozen = None if static is None else static.frozen.held
        image, alpha = arrays.blend(bins, colors, frozen)
        target = array(shown.pixels[0, draw.camera])
        if shown.unknown is not None:
            drawn = image if camera.background is None else image + camera.background
            known = torch.from_numpy(drawn), None if gain is None else torch.from_numpy(gain)
            target = array(shown.target(0, draw.camera, *known))
        found = arrays.photometric_loss(image, target, LAMBDA_DSSIM, gain, None, camera.background)
        to_splats = arrays.blend_gradient(
            bins, colors, image, found.d_image, alpha, arrays.no_gradient(alpha.shape), frozen
        )
        splats = [to_splats.means2d, to_splats.conics, to_splats.colors, to_splats.opacities]
        screen = to_splats.absolute if self._state.measures_absolute else splats[0]
        self._add_surfaces(draw, bins, seen, target, alpha, splats)
        return _Compared(found.loss, splats, found.d_gain if self._state.gains.enabled else None, screen)

    def _compare_tiles(
        self,
        draw: KeyframeDraw,
        camera: Seen,
        bins: arrays.Bins,
        colors: np.ndarray,
        _: arrays.ProjectedPoints,
        static: StaticView | None,
        gain: np.ndarray | None,
    ) -> _Compared:
        """Draw and compare the tiles that points touch, among static points."""
        assert static is not None
        target = array(self.images.of_iteration(draw.iteration)[0].pixels[0, draw.camera])
        options = LAMBDA_DSSIM, gain, camera.background
        loss, found = arrays.layered_loss(bins, colors, static.frozen.held, target, *options)
        splats = [found.means2d, found.conics, found.colors, found.opacities]
        return _Compared(loss, splats, None, found.means2d)

    def _add_surfaces(
        self,
        draw: KeyframeDraw,
        bins: arrays.Bins,
        seen: arrays.ProjectedPoints,
        target: np.ndarray,
        alpha: np.ndarray,
        splats: list[np.ndarray],
    ) -> None:
        """Add the gradients of the losses of surfaces, see `regularizers`, to those to means2d, conics and opacities."""
        near = self.images.near
        before, bent = self._weight(draw, before_surfaces), self._weight(draw, bent_surfaces)
        if not (before or bent):
            return
        powers = depth_powers(seen.depths, near)
        sums, _ = arrays.blend(bins, powers)
        d_sums, d_alpha = surface_gradients(sums, alpha, target, before, bent, self.images.unit / near)
        found = arrays.blend_gradient(bins, powers, sums, d_sums, alpha, d_alpha)
        for into, part in ((0, found.means2d), (1, found.conics), (3, found.opacities)):
            splats[into] = splats[into] + part

    def _weight(self, draw: KeyframeDraw, cost: Cost[KeyframeStep]) -> float:
        """Return the weight of the losses with a function; 0 if none runs."""
        return weight_of(cost, self._state.losses, draw, self._state.config)

    def follow(self, draw: KeyframeDraw, place: int, found: _Gradients) -> Outcome:
        """See `CpuProgram`."""
        points, density, view = self._state.points, self._state.density, self.seen(place).view
        if draw.metered:
            density.meter.add(torch.from_numpy(found.compared.screen), view.width, view.height)
        steps = []
        for one, rate, gradient in zip(points.adams.values(), draw.rates, found.points, strict=True):
            one.rate = rate
            steps.append(one.follow(torch.from_numpy(gradient), 0))
        before = points.means.detach().clone()
        adam.adam(steps)
        points.means.copy_(torch.lerp(before, points.means, density.distances[:, None]))
        if self.images.opposite is not None:
            bound_colors(points)
        if found.compared.gain is not None:
            self._state.gains.follow([(draw.camera, torch.from_numpy(found.compared.gain))])
        if draw.average:
            for mean, tensor in zip(self._averages, self._tensors, strict=True):
                mean.lerp_(tensor, draw.average)
        return Outcome(found.compared.loss, 0.0)
