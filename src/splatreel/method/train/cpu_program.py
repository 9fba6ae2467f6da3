"""Iterations of keyframes and groups on the CPU: a fixed order of kernels, and two draws at a time."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from splatreel.base import threads
from splatreel.base.errors import GaussiansError
from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.kernels import adam, deform
from splatreel.kernels.binning import bin_splats
from splatreel.kernels.splat import Splats
from splatreel.method.cameras.time_offsets import neighborhood, slope
from splatreel.method.deform.protocol import Slope
from splatreel.method.train.losses import Terms
from splatreel.method.train.programs import Draw, GroupState, KeyframeDraw, KeyframeState, Outcome
from splatreel.method.train.render import NO_CHANGE, View
from splatreel.method.train.subject import bound_colors
from splatreel.method.train.terms.photometric import LAMBDA_DSSIM, Compared, ImageSplats, compare
from splatreel.method.train.terms.term import Due, GroupIteration, Iteration, Neighbors, due_terms, reported_loss
from splatreel.method.train.trainable_points import NAMES
from splatreel.method.train.training_images import TrainingImages

TOGETHER = 2
"""Draws whose gradients are computed at the same time, from the same state. Optimizer steps follow in turn. It does not depend on the
number of cores, so that results do not either."""

D = TypeVar("D", Draw, KeyframeDraw)
G = TypeVar("G")


class CpuProgram(ABC, Generic[D, G]):
    """Program on the CPU, see `Program`. The state is that of the host. D: a draw. G: all gradients of a draw."""

    def __init__(self, images: TrainingImages, losses: Terms, config: GroupConfig | KeyframeConfig) -> None:
        self.images = images
        self._losses = losses
        self._config = config

    def upload(self) -> None:
        """Do nothing: the state is that of the host."""

    def run(self, draws: Sequence[D]) -> list[Outcome]:
        """See `Program`."""
        found: list[Outcome] = []
        while (first := len(found)) < len(draws):
            found += self._run_together(draws[first : first + self.together(draws[first])])
        return found

    def together(self, draw: D) -> int:
        """Return the number of draws, this one first, that start from the same state. Functions of a user run one at a time."""
        return 1 if any(term.reads_image for term in self._losses) else TOGETHER

    def give_meters(self) -> None:
        """Do nothing: each draw gives its gradients."""

    def download(self, moments: bool = True) -> None:
        """Do nothing: the state is that of the host."""

    @abstractmethod
    def prepare(self, draw: D) -> int:
        """Compute what draws share. Return the place of a draw's view in `images.all_views`."""

    @abstractmethod
    def gradients(self, draw: D, place: int) -> G:
        """Draw, compare, and compute all gradients. This only reads the state.

        Raises:
            GaussiansError: The loss or a splat is NaN or infinite.
        """

    @abstractmethod
    def follow(self, draw: D, place: int, found: G) -> Outcome:
        """Take the optimizer steps of a draw, and give its gradients to density control."""

    def due(self, draw: D) -> Due:
        """Return the terms that run in a draw, with their weights."""
        return due_terms(self._losses, draw, self._config)

    def _run_together(self, draws: Sequence[D]) -> list[Outcome]:
        """Run draws from one state, each on its share of the threads if they draw different views."""
        places = [self.prepare(draw) for draw in draws]
        found: list[G] = [None] * len(draws)  # type: ignore[list-item]
        share = threads.count() // len(draws)

        def compute(first: int, last: int) -> None:
            with threads.at_most(share):
                for k in range(first, last):
                    found[k] = self.gradients(draws[k], places[k])

        # Draws of one view use the same frozen splats, one after the other.
        threads.run_ranges(compute, len(draws), (), chunks=len(set(places)))
        return [self.follow(draw, place, one) for draw, place, one in zip(draws, places, found, strict=True)]


def check_loss(loss: float, splats: Sequence[np.ndarray]) -> None:
    """Raise a `GaussiansError` if a loss, or a value of splats that get gradients, is NaN or infinite."""
    if not math.isfinite(loss + float(sum(part.sum() for part in splats))):
        raise GaussiansError(f"the training error is {loss}, or a splat is not finite")


def splat_gradients(compared: Compared, seen: Iteration, due: Due) -> list[np.ndarray]:
    """Return the gradients to means2d, conics, colors and opacities of `seen.splats`, of the image and of its depths.

    `compared` has gradients of these splats, and perhaps of others after them.
    """
    found = [part[: len(seen.splats.means2d)] for part in compared.splats]
    for term, weight in due:
        if not term.reads_image:
            term.add_to_drawing(seen, weight)
    if (depths := seen.depth_gradients()) is not None:
        for place, part in zip((0, 1, 3), depths, strict=True):
            found[place] = found[place] + part
    return found


class _GroupGradients(NamedTuple):
    """Result of a draw: gradients to the points by name, to the models of motion and appearance, and of screen positions [M, 2]."""

    points: dict[str, np.ndarray]
    slopes: list[Slope]
    shade: np.ndarray
    d_shade: np.ndarray
    screen: np.ndarray
    outcome: Outcome


class CpuGroupProgram(CpuProgram[Draw, _GroupGradients]):
    """Program of a group, see `GroupProgram`."""

    def __init__(self, state: GroupState) -> None:
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

    def gradients(self, draw: Draw, place: int) -> _GroupGradients:
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
        return _GroupGradients(gradients, slopes + seen.slopes, shade, found[7], compared.splats[0], outcome)

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

    def follow(self, draw: Draw, place: int, found: _GroupGradients) -> Outcome:
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


class _KeyframeGradients(NamedTuple):
    """Result of a draw: its loss, gradients to the points by name and to the color gain [3], and what density control measures, [N, 2].

    gain is None if it is not learned.
    """

    loss: float
    points: dict[str, np.ndarray]
    gain: np.ndarray | None
    screen: np.ndarray


class CpuKeyframeProgram(CpuProgram[KeyframeDraw, _KeyframeGradients]):
    """Program of a keyframe, see `KeyframeProgram`."""

    def __init__(self, state: KeyframeState) -> None:
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

    def gradients(self, draw: KeyframeDraw, place: int) -> _KeyframeGradients:
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
        return _KeyframeGradients(reported_loss(seen, due), seen.gradients, learned, screen)

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

    def follow(self, draw: KeyframeDraw, place: int, found: _KeyframeGradients) -> Outcome:
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
    step = array - mean
    if weight < 0.5:
        mean += np.float32(weight) * step
    else:
        np.subtract(array, step * np.float32(1 - weight), out=mean)
