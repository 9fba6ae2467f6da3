"""Iterations of a group on the CPU, without autograd."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch

from splatreel.kernels import adam, arrays
from splatreel.method.deform.trajectory import Slopes
from splatreel.method.train.cpu_motion import CpuMotion, Moment
from splatreel.method.train.cpu_program import CpuProgram, array, check_loss
from splatreel.method.train.losses import rigidity, smoothness, view_dependence, weight_of
from splatreel.method.train.programs import Draw, GroupState, Outcome
from splatreel.method.train.regularizers import Neighbors


class _Gradients(NamedTuple):
    """Result of a draw: gradients to the canonical points and to the splines, and what density control measures."""

    canonical: Sequence[np.ndarray]
    splines: list[Slopes]
    shade: np.ndarray
    screen: np.ndarray
    moment: Moment
    outcome: Outcome


class CpuGroupProgram(CpuProgram[Draw, _Gradients]):
    """Program of a group, see `Program`. The losses are those of `programs.GROUP_COSTS`.

    Attributes:
        neighbors: Nearest neighbors; None for fewer than two points.
        learns_time: Slopes of the time offsets are measured.
    """

    def __init__(self, state: GroupState) -> None:
        """Prepare a program; `upload` follows."""
        points, density, images, config, losses, gains, learns_time = state
        super().__init__(images)
        self.neighbors: Neighbors | None = None
        self.learns_time = learns_time
        self._points = points
        self._density = density
        self._config = config
        self._losses = losses
        self._gains = gains

    def upload(self) -> None:
        """See `Program`."""
        super().upload()
        self._motion = CpuMotion(self._points, self.images.count, self.learns_time)
        self._canonical = [array(one.tensor) for one in self._points.canonical.adams.values()]

    def prepare(self, draw: Draw) -> int:
        """See `CpuProgram`."""
        place = self.images.of_iteration(draw.iteration)[1] + draw.camera
        self._density.static.view(place)
        self._motion.catch_up(draw)
        return place

    def gradients(self, draw: Draw, place: int) -> _Gradients:
        """See `CpuProgram`."""
        weight = partial(weight_of, losses=self._losses, step=draw, config=self._config)
        view, pinhole, center, _ = self.seen(place)
        moment = self._motion.at(draw.moment)
        points = arrays.DeformedPoints._make([*self._canonical, moment.dx, moment.dq, moment.shade])
        opacities, seen = arrays.deform(points, center, pinhole)
        loss, screen, d_splats = self._compare(draw, place, seen, opacities)
        *d_canonical, d_dq, d_shade = arrays.deform_gradient(points, seen, center, pinhole, *d_splats)
        self._price_bands(weight(view_dependence) / (view.width * view.height), points.rest, d_canonical[-1])

        d_dx = d_canonical[0]
        if draw.rank is not None and self.neighbors is not None:
            d_rigid = self._motion.rigidity(moment, self.neighbors, draw.rank, weight(rigidity))
            d_dx, d_dq = d_dx + d_rigid[0], d_dq + d_rigid[1]
        slopes = self._motion.slopes(d_dx, d_dq)
        splines = [(*self._motion.knots(draw.moment), slopes)]
        if draw.span is not None:
            splines += self._motion.smoothness(draw.span, weight(smoothness))
        slope = self._motion.time_slope(draw.moment, slopes) if self.learns_time else 0.0
        return _Gradients(d_canonical, splines, d_shade, screen, moment, Outcome(loss, slope))

    def _compare(
        self, draw: Draw, place: int, seen: arrays.ProjectedPoints, opacities: np.ndarray
    ) -> tuple[float, np.ndarray, list[np.ndarray]]:
        """Draw the points among the static ones and compare the image.

        Returns:
            The loss, the gradients [M, 2] to screen positions, and those to means2d, conics, colors and opacities of the moving points.
        """
        view, _, _, background = self.seen(place)
        static = self._density.static.view(place)
        colors = seen.colors if background is None else seen.colors - background
        splats, where, n = (seen.means2d, seen.conics, colors, opacities, seen.depths, seen.radii), None, len(opacities)
        if draw.metered_static:
            splats = tuple(np.concatenate([a, array(b)]) for a, b in zip(splats, static.splats, strict=True))
            measured = (self._density.convertible & self._density.static.alive)[static.index]
            where = np.concatenate([np.ones(n, bool), array(measured)])
        means2d, conics, colors, opaque, depths, radii = splats
        bins = arrays.bin_splats(means2d, conics, opaque, depths, radii, view.width, view.height)
        shown = self.images.of_iteration(draw.iteration)[0]
        target, gain = array(shown.pixels[draw.frame, draw.camera]), array(self._gains.values[draw.camera])
        unknown = None if shown.unknown is None else array(shown.unknown[draw.frame, draw.camera])
        options = self._config.lambda_dssim, gain, background, where, draw.whole, unknown
        loss, found = arrays.layered_loss(bins, colors, static.frozen.held, target, *options)
        check_loss(loss, splats[:4])
        gradients = found.means2d, found.conics, found.colors, found.opacities
        return loss, found.means2d, [part[:n] for part in gradients]

    @staticmethod
    def _price_bands(price: float, rest: np.ndarray, d_rest: np.ndarray) -> None:
        """Add the gradient of the L1 norm of the higher SH bands, see `losses.view_dependence`."""
        size = rest.shape[1] * rest.shape[2]
        if price and size:
            arrays.add_signs(rest.reshape(-1, size), np.full(size, price, np.float32), d_rest.reshape(-1, size))

    def follow(self, draw: Draw, place: int, found: _Gradients) -> Outcome:
        """See `CpuProgram`."""
        if draw.metered:
            view, screen = self.seen(place).view, torch.from_numpy(found.screen)
            moving, index = len(self._points), self._density.static.view(place).index
            self._density.moving_meter.add(screen[:moving], view.width, view.height)
            if draw.metered_static:
                self._density.static_meter.add(screen[moving:], view.width, view.height, index)
        canonical = self._points.canonical
        canonical.scale_rates({}, default=draw.pace * 0.1**draw.share)
        each = zip(canonical.adams.values(), found.canonical, strict=True)
        steps = [one.follow(torch.from_numpy(gradient), 0) for one, gradient in each]
        adam.adam(steps + self._motion.steps(draw, found.moment, found.splines, found.shade))
        return found.outcome
