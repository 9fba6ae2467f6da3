"""Drawing during training. Static points are projected and sorted once per view, then combined with moving points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from splatreel.kernels import deform, rasterize, splat
from splatreel.kernels.project import BLUR, FINE_BLUR, Pinhole
from splatreel.kernels.splat import Splats
from splatreel.method.init.layout import Layout
from splatreel.method.train.trainable_points import NAMES, to_params
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

NO_CHANGE = tuple(np.zeros((0, size), np.float32) for size in (3, 4, 4))
"""dx, dq and shade of points that do not change, see `deform.DeformedPoints`."""


@dataclass(frozen=True)
class View:
    """A camera as arrays that kernels take.

    Attributes:
        viewmat: [4, 4] world to camera.
        K: [3, 3] intrinsics, pixels.
        center: [3] camera position, world units.
        antialias: Draw as `splat.antialiased` describes.
        clear: Depth up to which no static point is drawn (`Clearance`), world units.
        background: [3] color behind all points, 0..1; None is black.
        gain: [3] color gain of the camera that the background is divided by; None if the gain changes the background too.
    """

    viewmat: np.ndarray
    K: np.ndarray
    center: np.ndarray
    width: int
    height: int
    antialias: bool = False
    clear: float = 0.0
    background: np.ndarray | None = None
    gain: np.ndarray | None = None
    _pinholes: dict[float, Pinhole] = field(default_factory=dict, init=False, repr=False, compare=False)

    @staticmethod
    def of(
        camera: Camera, antialias: bool = False, layout: Layout | None = None, gain: np.ndarray | None = None
    ) -> View:
        """Convert a camera. A layout adds clearance and background. `gain` is the camera's color gain [3]; None is 1."""
        viewmat, K, center = (np.array(each, np.float32) for each in (camera.viewmat, camera.K, camera.center))
        plain = View(viewmat, K, center, camera.width, camera.height, antialias)
        if layout is None:
            return plain
        gain = np.ones(3, np.float32) if gain is None else np.array(gain, np.float32)
        color = np.array(layout.background_of(camera, gain), np.float32)
        plain = replace(plain, clear=layout.clearance.depth(camera), background=color if color.any() else None)
        return replace(plain, gain=gain) if layout.backgrounds else plain

    def pinhole(self, near: float) -> Pinhole:
        """Return the view as projection takes it. near: smallest depth drawn, world units."""
        if near not in self._pinholes:
            blur = FINE_BLUR if self.antialias else BLUR
            self._pinholes[near] = Pinhole(self.viewmat, self.K, self.width, self.height, near, blur)
        return self._pinholes[near]

    def halved(self) -> View:
        """Return the view of images at half size (`halved`)."""
        K = self.K.copy()
        K[:2] /= 2
        return replace(self, K=K, width=self.width // 2, height=self.height // 2)


@dataclass(frozen=True)
class StaticView:
    """Static points that one view sees.

    Attributes:
        splats: M projected points.
        index: [M] row of each among all static points.
        frozen: The sorted splats.
        rows: [M] row of each among the frozen splats.
    """

    splats: Splats
    index: np.ndarray
    frozen: rasterize.Frozen
    rows: np.ndarray

    def keep(self, kept: np.ndarray) -> StaticView:
        """Return the view with the points of a mask [M] bool only. The frozen splats are changed."""
        if kept.all():
            return self
        rasterize.remove(self.frozen, self.rows[~kept])
        return StaticView(self.splats.rows(np.flatnonzero(kept)), self.index[kept], self.frozen, self.rows[kept])


def relative_distances(means: np.ndarray, views: list[View], unit: float, reach: float) -> np.ndarray:
    """Return the distance [N] of points to the nearest view, in viewing distances, clamped to 1..reach.

    Step sizes and size limits of far points are scaled by it. In pixels they are then the same at any distance.
    """
    squares = np.full(len(means), np.inf, np.float32)
    for view in views:
        squares = np.minimum(squares, np.square(means - view.center).sum(1))
    return (np.sqrt(squares) / unit).clip(1, reach)


def deformed(
    params: Mapping[str, np.ndarray],
    offsets: tuple[np.ndarray, np.ndarray] | None,
    shade: np.ndarray | None,
    view: View,
    near: float,
) -> Splats:
    """Deform points, project them and compute their colors, which are relative to the background (paper section 4.2).

    `offsets` are dx [N, 3] and dq [N, 4]; the result has means x + dx and quats q * dq. `shade` [N, 4] is added to
    c_base and to the logit of the opacity.

    Raises:
        GaussiansError: If a value is NaN or infinite.
    """
    dx, dq = NO_CHANGE[:2] if offsets is None else offsets
    splat.check_finite(means=params["means"], quats=params["quats"], log_scales=params["log_scales"], dx=dx, dq=dq)
    changes = dx, dq, NO_CHANGE[2] if shade is None else shade
    moment = deform.DeformedPoints._make([*(params[name] for name in NAMES), *changes])
    opacities, seen = deform.forward(moment, view.center, view.pinhole(near))
    splats = Splats(seen.means2d, seen.conics, seen.colors, opacities, seen.depths, seen.radii)
    return splats.relative_to(view.background)


class StaticCache:
    """Frozen static points. Each view projects, colors and sorts them once."""

    def __init__(self, gaussians: Gaussians, views: list[View], near: float) -> None:
        self.views = views
        self.near = near
        self.params = to_params(gaussians)
        self.alive = np.ones(len(gaussians), bool)
        self._views: dict[int, StaticView] = {}

    def __len__(self) -> int:
        """Return the number of points, hidden ones included."""
        return len(self.alive)

    @property
    def means(self) -> np.ndarray:
        """Positions [S, 3]."""
        return self.params["means"]

    def set_alive(self, alive: np.ndarray) -> None:
        """Hide points that became dynamic. alive: [S] bool, a subset of the points that are alive now."""
        self.alive = alive.copy()
        self._views = {camera: view.keep(alive[view.index]) for camera, view in self._views.items()}

    def revive(self, alive: np.ndarray) -> None:
        """Replace the mask of living points, [S] bool. Unlike `set_alive`, it may show hidden points again."""
        self.alive = alive
        self._views.clear()

    def view(self, place: int) -> StaticView:
        """Return the living points that view number `place` sees."""
        if place not in self._views:
            index = np.flatnonzero(self.alive)
            view = self.views[place]
            living = {name: value[index] for name, value in self.params.items()}
            projected = deformed(living, None, None, view, max(self.near, view.clear))
            seen = np.flatnonzero(projected.radii > 0)
            shown = projected.rows(seen)
            frozen = splat.freeze(shown, view.width, view.height)
            self._views[place] = StaticView(shown, index[seen], frozen, np.arange(len(seen)))
        return self._views[place]

    def set_views(self, views: list[View]) -> None:
        """Replace the views."""
        self.views = views
        self._views.clear()


def draw(splats: Splats, view: View, static: StaticView | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Draw splats, together with a view's static ones if given. Return the image [H, W, 3] and alpha [H, W]."""
    frozen = None if static is None else static.frozen
    image, alpha = splat.rasterize(splats, view.width, view.height, frozen)
    return image if view.background is None else image + view.background, alpha


def contributions(splats: Splats, view: View, static: StaticView | None) -> np.ndarray:
    """Return the pixels that every splat fills in a view, [N]: the sum of its blending weights, with static points in front of some."""
    frozen = None if static is None else static.frozen
    bins, black = splat.bin(splats, view.width, view.height), np.zeros_like(splats.colors)
    image, alpha = rasterize.forward(bins, black, frozen)
    none = rasterize.no_gradient(alpha.shape)
    return rasterize.backward(bins, black, image, np.ones_like(image), alpha, none, frozen).colors[:, 0]
