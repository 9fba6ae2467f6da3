"""Iterations of a group on the CPU: a fixed order of kernels, without autograd.

With autograd, torch and Python take a third of an iteration, on one core while the others wait.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from splatreel.base import threads
from splatreel.base.errors import GaussiansError
from splatreel.kernels import adam, arrays
from splatreel.method.deform.trajectory import Slopes
from splatreel.method.train.cpu_motion import CpuMotion, Moment, array
from splatreel.method.train.losses import GROUP
from splatreel.method.train.programs import Draw, GroupState, Outcome
from splatreel.method.train.regularizers import Neighbors
from splatreel.method.train.render import View

TOGETHER = 2
"""Draws whose gradients are computed at the same time, from the same state. Optimizer steps follow in turn. It does not depend on the
number of cores, so that results do not either."""


class _Seen(NamedTuple):
    """A view of the training images as the kernels take it."""

    view: View
    pinhole: arrays.Pinhole
    center: np.ndarray


class _Gradients(NamedTuple):
    """Result of a draw: gradients to the canonical points and to the splines, and what density control measures."""

    canonical: Sequence[np.ndarray]
    splines: list[Slopes]
    shade: np.ndarray
    screen: np.ndarray
    moment: Moment
    outcome: Outcome


class CpuGroupProgram:
    """Program of a group, see `Program`. The losses are those of `losses.GROUP`. The state is that of the host.

    Attributes:
        images: Images in use.
        neighbors: Nearest neighbors; None for fewer than two points.
        learns_time: Slopes of the time offsets are measured.
    """

    def __init__(self, state: GroupState) -> None:
        """Prepare a program; `upload` follows."""
        points, density, images, config, gains, learns_time = state
        self.images = images
        self.neighbors: Neighbors | None = None
        self.learns_time = learns_time
        self._points = points
        self._density = density
        self._config = config
        self._gains = gains

    def upload(self) -> None:
        """Refer to the arrays of the host."""
        self._motion = CpuMotion(self._points, self.images.count, self.learns_time)
        self._canonical = [array(one.tensor) for one in self._points.canonical.adams.values()]
        self._views: dict[int, _Seen] = {}

    def run(self, draws: Sequence[Draw]) -> list[Outcome]:
        """See `Program`."""
        found: list[Outcome] = []
        with torch.no_grad():
            for k in range(0, len(draws), TOGETHER):
                found += self._run_together(draws[k : k + TOGETHER])
        return found

    def give_meters(self) -> None:
        """Do nothing: each draw gives its gradients."""

    def download(self) -> None:
        """Do nothing: the state is that of the host."""

    def _run_together(self, draws: Sequence[Draw]) -> list[Outcome]:
        """Run draws from one state, each on its share of the threads if they draw different views."""
        places = [self._prepare(draw) for draw in draws]
        found: list[_Gradients] = [None] * len(draws)  # type: ignore[list-item]

        def compute(first: int, last: int) -> None:
            with torch.no_grad(), threads.divided(len(draws)):
                for k in range(first, last):
                    found[k] = self._gradients(draws[k], places[k])

        # Draws of one view use the same frozen splats, one after the other.
        threads.run_ranges(compute, len(draws), (), chunks=len(set(places)))
        return [self._follow(draw, place, one) for draw, place, one in zip(draws, places, found, strict=True)]

    def _prepare(self, draw: Draw) -> int:
        """Compute what draws share. Return the place of a draw's view in `images.all_views`."""
        place = self.images.of_iteration(draw.iteration)[1] + draw.camera
        if place not in self._views:
            view = self.images.all_views[place]
            blur = arrays.FINE_BLUR if view.antialias else arrays.BLUR
            lens = array(view.viewmat), array(view.K), view.width, view.height, self.images.near, blur
            self._views[place] = _Seen(view, arrays.Pinhole(*lens), array(view.center))
        self._density.static.view(place)
        self._motion.catch_up(draw)
        return place

    def _gradients(self, draw: Draw, place: int) -> _Gradients:
        """Draw, compare, and compute all gradients. This only reads the state.

        Raises:
            GaussiansError: The loss or a splat is NaN or infinite.
        """
        weights = {loss.name: loss.weight_at(draw, self._config) for loss in GROUP}
        view, pinhole, center = self._views[place]
        moment = self._motion.at(draw.moment)
        points = arrays.DeformedPoints._make([*self._canonical, moment.dx, moment.dq, moment.shade])
        opacities, seen = arrays.deform(points, center, pinhole)
        loss, screen, d_splats = self._compare(draw, place, seen, opacities)
        *d_canonical, d_dq, d_shade = arrays.deform_gradient(points, seen, center, pinhole, *d_splats)
        self._price_bands(weights["view dependence"] / (view.width * view.height), points.rest, d_canonical[-1])

        d_dx = d_canonical[0]
        if weights["rigidity"] and draw.rank is not None and self.neighbors is not None:
            d_rigid = self._motion.rigidity(moment, self.neighbors, draw.rank, weights["rigidity"])
            d_dx, d_dq = d_dx + d_rigid[0], d_dq + d_rigid[1]
        slopes = self._motion.slopes(d_dx, d_dq)
        splines = [(*self._motion.knots(draw.moment), slopes)]
        if weights["smoothness"] and draw.span is not None:
            splines += self._motion.smoothness(draw.span, weights["smoothness"])
        slope = self._motion.time_slope(draw.moment, slopes) if self.learns_time else 0.0
        return _Gradients(d_canonical, splines, d_shade, screen, moment, Outcome(loss, slope))

    def _compare(
        self, draw: Draw, place: int, seen: arrays.ProjectedPoints, opacities: np.ndarray
    ) -> tuple[float, np.ndarray, list[np.ndarray]]:
        """Draw the points among the static ones and compare the image.

        Returns:
            The loss, the gradients [M, 2] to screen positions, and those to means2d, conics, colors and opacities of the moving points.
        """
        view, static = self._views[place].view, self._density.static.view(place)
        background = None if view.background is None else array(view.background)
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
        options = self._config.lambda_dssim, gain, background, where, draw.whole
        loss, found = arrays.loss_and_gradient(bins, colors, static.frozen.held, target, *options)
        if not math.isfinite(loss + float(sum(part.sum() for part in splats[:4]))):
            raise GaussiansError(f"the training error is {loss}, or a splat is not finite")
        gradients = found.means2d, found.conics, found.colors, found.opacities
        return loss, found.means2d, [part[:n] for part in gradients]

    @staticmethod
    def _price_bands(price: float, rest: np.ndarray, d_rest: np.ndarray) -> None:
        """Add the gradient of the L1 norm of the higher SH bands, see `losses.view_dependence`."""
        size = rest.shape[1] * rest.shape[2]
        if price and size:
            arrays.add_signs(rest.reshape(-1, size), np.full(size, price, np.float32), d_rest.reshape(-1, size))

    def _follow(self, draw: Draw, place: int, found: _Gradients) -> Outcome:
        """Take the optimizer steps of a draw, and give its gradients to density control."""
        if draw.metered:
            view, screen = self._views[place].view, torch.from_numpy(found.screen)
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
