"""Iterations of a group on the CPU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splatreel.kernels import adam, deform
from splatreel.kernels.binning import bin_splats
from splatreel.kernels.splat import Splats
from splatreel.method.cameras.time_offsets import neighborhood, slope
from splatreel.method.deform.protocol import Slope
from splatreel.method.train.cpu_program import CpuProgram, check_loss, splat_gradients
from splatreel.method.train.losses import LAMBDA_DSSIM
from splatreel.method.train.programs import Draw, GroupState, Outcome
from splatreel.method.train.regularizers import Neighbors
from splatreel.method.train.render import NO_CHANGE
from splatreel.method.train.terms.photometric import Compared, ImageSplats, compare
from splatreel.method.train.terms.term import Due, GroupIteration, reported_loss
from splatreel.method.train.trainable_points import NAMES


class _Gradients(NamedTuple):
    """Result of a draw: gradients to the points by name, to the models of motion and appearance, and of screen positions [M, 2]."""

    points: dict[str, np.ndarray]
    slopes: list[Slope]
    shade: np.ndarray
    d_shade: np.ndarray
    screen: np.ndarray
    outcome: Outcome


class CpuGroupProgram(CpuProgram[Draw, _Gradients]):
    """Program of a group, see `Program`.

    Attributes:
        neighbors: Nearest neighbors; None for fewer than two points.
        learns_time: Slopes of the time offsets are measured.
    """

    def __init__(self, state: GroupState) -> None:
        """Prepare a program; `upload` follows."""
        super().__init__(state.images, state.losses, state.config)
        self.neighbors: Neighbors | None = None
        self.learns_time = state.learns_time
        self._points = state.points
        self._density = state.density
        self._gains = state.gains

    def prepare(self, draw: Draw) -> int:
        """See `CpuProgram`."""
        place = self.images.of_iteration(draw.iteration)[1] + draw.camera
        self._density.static.view(place)
        times = [draw.moment, *(neighborhood(draw.moment, self.images.count) if self.learns_time else ())]
        if draw.span is not None:
            times += draw.span[:2]
        self._points.deformation.extend_to(draw.last)
        self._points.deformation.prepare(times)
        if self._points.appearance is not None:
            self._points.appearance.prepare([draw.moment])
        return place

    def gradients(self, draw: Draw, place: int) -> _Gradients:
        """See `CpuProgram`."""
        model, canonical, due = self._points.deformation, self._points.canonical.params, self.due(draw)
        view, shown = self.images.all_views[place], self.images.of_iteration(draw.iteration)[0]
        pinhole, means = view.pinhole(self.images.near), canonical["means"]
        dx, dq = model.offsets(means, draw.moment)
        shade = NO_CHANGE[2] if self._points.appearance is None else self._points.appearance.at(draw.moment)
        points = deform.DeformedPoints._make([*(canonical[name] for name in NAMES), dx, dq, shade])
        opacities, projected = deform.forward(points, view.center, pinhole)
        colors = projected.colors if view.background is None else projected.colors - view.background
        splats = Splats(projected.means2d, projected.conics, colors, opacities, projected.depths, projected.radii)
        seen = GroupIteration(
            iteration=draw.iteration,
            share=draw.share,
            camera=draw.camera,
            moment=draw.moment,
            view=view,
            near=self.images.near,
            unit=self.images.unit,
            target=shown.pixels[draw.frame, draw.camera],
            points={**canonical, "dx": dx, "dq": dq},
            splats=splats,
            deformation=model,
            neighbors=self.neighbors,
            rank=draw.rank,
            span=draw.span,
        )
        compared = self._compare(draw, place, seen, due)
        d_splats = splat_gradients(compared, seen, due)
        found = list(deform.backward(points, projected, view.center, pinhole, *d_splats))
        seen.gradients = {**dict(zip(NAMES, found, strict=False)), "dx": found[0], "dq": found[6]}
        for term, weight in due:
            term.add_to_points(seen, weight)
        gradients = {name: seen.gradients[name] for name in NAMES}
        slopes = model.gradient(means, [(1.0, draw.moment)], seen.gradients["dx"], seen.gradients["dq"])
        late = slope(model, means, draw.moment, self.images.count, slopes) if self.learns_time else 0.0
        outcome = Outcome(reported_loss(seen, due), late)
        return _Gradients(gradients, slopes + seen.slopes, shade, found[7], compared.splats[0], outcome)

    def _compare(self, draw: Draw, place: int, seen: GroupIteration, due: Due) -> Compared:
        """Draw the points among the static ones and compare the image. Static points follow the others in the gradients."""
        view, static = self.images.all_views[place], self._density.static.view(place)
        splats, where, frozen = seen.splats, None, static.frozen
        if draw.metered_static:
            measured = (self._density.convertible & self._density.static.alive)[static.index]
            where, frozen = np.concatenate([np.ones(len(splats.means2d), bool), measured]), None
            splats = Splats.join(splats, static.splats)
        means2d, conics, colors, opaque, depths, radii = splats
        bins = bin_splats(means2d, conics, opaque, depths, radii, view.width, view.height)
        seen.bins = bins if where is None else None
        shown, gain = self.images.of_iteration(draw.iteration)[0], self._gains.values[draw.camera]
        unknown = None if shown.unknown is None else shown.unknown[draw.frame, draw.camera]
        given = ImageSplats(
            bins=bins,
            colors=colors,
            frozen=frozen,
            background=view.background,
            gain=gain,
            where=where,
            whole=draw.whole,
            learns_gain=False,
            unknown=unknown,
            fill=lambda drawn: shown.target(draw.frame, draw.camera, drawn, gain),
        )
        found = compare(given, static.frozen, LAMBDA_DSSIM, seen, due)
        check_loss(seen.photometric or 0.0, splats[:4])
        return found

    def follow(self, draw: Draw, place: int, found: _Gradients) -> Outcome:
        """See `CpuProgram`."""
        if draw.metered:
            view = self.images.all_views[place]
            moving, index = len(self._points), self._density.static.view(place).index
            self._density.moving_meter.add(found.screen[:moving], view.width, view.height)
            if draw.metered_static:
                self._density.static_meter.add(found.screen[moving:], view.width, view.height, index)
        canonical = self._points.canonical
        canonical.scale_rates({}, default=draw.pace * 0.1**draw.share)
        steps = canonical.follow([found.points[name] for name in NAMES])
        steps += self._points.deformation.steps(found.slopes, draw.share, draw.pace)
        if self._points.appearance is not None:
            steps += self._points.appearance.steps(draw.moment, found.shade, found.d_shade, draw.share, draw.pace)
        adam.adam(steps)
        return found.outcome
