"""Iterations of a keyframe on the CPU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splatreel.kernels import adam, deform
from splatreel.kernels.binning import bin_splats
from splatreel.kernels.splat import Splats
from splatreel.method.train.cpu_program import CpuProgram, check_loss, splat_gradients
from splatreel.method.train.hidden_colors import bound_colors
from splatreel.method.train.losses import LAMBDA_DSSIM
from splatreel.method.train.programs import KeyframeDraw, KeyframeState, Outcome
from splatreel.method.train.render import NO_CHANGE, View
from splatreel.method.train.terms.photometric import Compared, ImageSplats, compare
from splatreel.method.train.terms.term import Due, Iteration, reported_loss
from splatreel.method.train.trainable_points import NAMES


class _Gradients(NamedTuple):
    """Result of a draw: its loss, gradients to the points by name and to the color gain [3], and what density control measures, [N, 2].

    gain is None if it is not learned.
    """

    loss: float
    points: dict[str, np.ndarray]
    gain: np.ndarray | None
    screen: np.ndarray


class CpuKeyframeProgram(CpuProgram[KeyframeDraw, _Gradients]):
    """Program of a keyframe, see `KeyframeProgram`."""

    def __init__(self, state: KeyframeState) -> None:
        """Prepare a program; `upload` follows."""
        super().__init__(state.images, state.losses, state.config)
        self._state = state

    def upload(self) -> None:
        """See `Program`."""
        self._averages = [np.zeros_like(array) for array in self._state.points.params.values()]

    def together(self, draw: KeyframeDraw) -> int:
        """See `CpuProgram`. While points are added, each draw starts from the last one's state: pairs would add 4 % fewer points."""
        return 1 if draw.metered else super().together(draw)

    def averages(self) -> list[np.ndarray]:
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
        params, view, due = self._state.points.params, self.images.all_views[place], self.due(draw)
        pinhole = view.pinhole(self.images.near)
        points = deform.DeformedPoints._make([*(params[name] for name in NAMES), *NO_CHANGE])
        opacities, projected = deform.forward(points, view.center, pinhole)
        tint, gain = self._gain(draw, view)
        colors = projected.colors if tint is None else projected.colors * tint
        colors = colors if view.background is None else colors - view.background
        splats = Splats(projected.means2d, projected.conics, colors, opacities, projected.depths, projected.radii)
        seen = Iteration(
            iteration=draw.iteration,
            share=draw.share,
            camera=draw.camera,
            moment=0.0,
            view=view,
            near=self.images.near,
            unit=self.images.unit,
            target=self.images.of_iteration(draw.iteration)[0].pixels[0, draw.camera],
            points=dict(params),
            splats=splats,
        )
        compared = self._compare(draw, place, seen, gain, due)
        screen = compared.absolute if draw.whole and self._state.measures_absolute else compared.splats[0]
        d_splats, d_gain = splat_gradients(compared, seen, due), compared.gain
        if tint is not None:
            d_gain = (d_splats[2] * projected.colors).sum(0) / gain
            d_splats[2] = d_splats[2] * tint
        found = deform.backward(points, projected, view.center, pinhole, *d_splats)
        seen.gradients = dict(zip(NAMES, found[:6], strict=True))
        for term, weight in due:
            term.add_to_points(seen, weight)
        learned = d_gain if draw.whole and self._state.gains.enabled else None
        return _Gradients(reported_loss(seen, due), seen.gradients, learned, screen)

    def _gain(self, draw: KeyframeDraw, view: View) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Return the factor [3] on the colors of the points, and that on the drawing. None is 1.

        Their product is the color gain of the camera. If a background is known only together with a gain (`View.gain`), this part is on
        the drawing, and the points carry the rest.
        """
        gains = self._state.gains
        if draw.whole and not gains.enabled:
            return None, None
        gain = gains.values[draw.camera]
        return (None, gain) if view.gain is None else (gain / view.gain, view.gain)

    def _compare(self, draw: KeyframeDraw, place: int, seen: Iteration, gain: np.ndarray | None, due: Due) -> Compared:
        """Draw the points, among static ones if there are any, and compare the image."""
        view, state = seen.view, self._state
        static = None if state.static is None else state.static.view(place).frozen
        means2d, conics, colors, opaque, depths, radii = seen.splats
        seen.bins = bin_splats(means2d, conics, opaque, depths, radii, view.width, view.height)
        shown = self.images.of_iteration(draw.iteration)[0]
        given = ImageSplats(
            bins=seen.bins,
            colors=colors,
            frozen=static,
            background=view.background,
            gain=gain,
            where=None,
            whole=draw.whole,
            learns_gain=draw.whole,
            unknown=None if shown.unknown is None else shown.unknown[0, draw.camera],
            fill=lambda drawn: shown.target(0, draw.camera, drawn, gain),
        )
        found = compare(given, static, LAMBDA_DSSIM, seen, due)
        check_loss(seen.photometric or 0.0, seen.splats[:4])
        return found

    def follow(self, draw: KeyframeDraw, place: int, found: _Gradients) -> Outcome:
        """See `CpuProgram`."""
        points, density, view = self._state.points, self._state.density, self.images.all_views[place]
        if draw.metered:
            density.meter.add(found.screen, view.width, view.height)
        for one, rate in zip(points.adams.values(), draw.rates, strict=True):
            one.rate = rate
        before = points.means.copy()
        adam.adam(points.follow([found.points[name] for name in NAMES]))
        # Far points take larger steps.
        points.means[:] -= (points.means - before) * (1 - density.distances[:, None])
        if self.images.opposite is not None:
            bound_colors(points)
        if found.gain is not None:
            self._state.gains.follow([(draw.camera, found.gain)])
        if draw.average:
            for mean, array in zip(self._averages, points.params.values(), strict=True):
                _lerp(mean, array, draw.average)
        return Outcome(found.loss, 0.0)


def _lerp(mean: np.ndarray, array: np.ndarray, weight: float) -> None:
    """Move a mean towards an array, in place."""
    step = array - mean
    if weight < 0.5:
        mean += np.float32(weight) * step
    else:
        np.subtract(array, step * np.float32(1 - weight), out=mean)
