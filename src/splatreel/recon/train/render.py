"""Drawing the scene while it trains: moving points in front of, between and behind static ones, which are drawn once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.recon.init.layout import Layout
from splatreel.recon.train.points import NAMES, to_params
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians


@dataclass(frozen=True)
class View:
    """A camera as tensors. viewmat: [4, 4]; K: [3, 3]; center: [3]. antialias: see `splat.antialiased`.

    clear: up to this depth no static point is drawn, world units (`Clearance`). background: [3], 0..1, where nothing is.
    """

    viewmat: Tensor
    K: Tensor
    center: Tensor
    width: int
    height: int
    antialias: bool = False
    clear: float = 0.0
    background: Tensor | None = None

    @staticmethod
    def of(camera: Camera, device: torch.device, antialias: bool = False, layout: Layout | None = None) -> View:
        arrays = camera.viewmat, camera.K, camera.center
        viewmat, K, center = (torch.from_numpy(array.copy()).to(device) for array in arrays)
        plain = View(viewmat, K, center, camera.width, camera.height, antialias)
        if layout is None:
            return plain
        background = torch.tensor(layout.background, device=device) if any(layout.background) else None
        return replace(plain, clear=layout.clearance.depth(camera), background=background)

    def halved(self) -> View:
        """The view of pictures that were `halved`."""
        K = self.K.clone()
        K[:2] /= 2
        return replace(self, K=K, width=self.width // 2, height=self.height // 2)


@dataclass(frozen=True)
class Splats:
    """Points as one view sees them, ready to be rasterized; fields as in `splat.rasterize`."""

    means2d: Tensor
    conics: Tensor
    colors: Tensor
    opacities: Tensor
    depths: Tensor
    radii: Tensor

    @property
    def tensors(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
        return self.means2d, self.conics, self.colors, self.opacities, self.depths, self.radii

    def rows(self, index: Tensor) -> Splats:
        """Those of an index [M] int64."""
        return Splats(*[tensor.index_select(0, index) for tensor in self.tensors])

    def relative_to(self, background: Tensor | None) -> Splats:
        """With colors relative to a background's [3]: blended, they are what a picture differs by, and `draw` adds it again.

        That blends the background behind everything without a look at alpha: sum w c + (1 - sum w) b = sum w (c - b) + b.
        """
        return self if background is None else replace(self, colors=self.colors - background)

    @staticmethod
    def join(a: Splats, b: Splats) -> Splats:
        return Splats(*[torch.cat(pair) for pair in zip(a.tensors, b.tensors, strict=True)])


@dataclass(frozen=True)
class StaticView:
    """What one view sees of the static points. index: [M] which of them. rows: [M] where they are among the frozen splats."""

    splats: Splats
    index: Tensor
    frozen: splat.FrozenSplats
    rows: Tensor

    def keep(self, kept: Tensor) -> StaticView:
        """Those of a mask [M] bool."""
        if bool(kept.all()):
            return self
        index, frozen = torch.nonzero(kept)[:, 0], splat.remove(self.frozen, self.rows[~kept])
        return StaticView(self.splats.rows(index), self.index[index], frozen, self.rows[index])


class Comparable(Protocol):
    """What a view sees, to be compared with a picture. means2d: [M, 2], a tensor of the graph that keeps its gradient (pixels).

    Its first `moving` rows are the moving points in their order; where everything has a gradient, the static points `index` follow.
    """

    @property
    def means2d(self) -> Tensor: ...
    @property
    def moving(self) -> int: ...
    @property
    def index(self) -> Tensor | None: ...

    def loss(self, target: Tensor, lambda_dssim: float, gain: Tensor | None) -> Tensor:
        """The photometric loss [] against a picture [H, W, 3] uint8, of a camera with a color gain [3]."""
        ...


@dataclass(frozen=True)
class Drawing:
    """All that a view sees. image: [H, W, 3]; alpha: [H, W]. Others as of `Comparable`.

    tiles: [ceil(H / 16), ceil(W / 16)] bool, all that was drawn anew and has a gradient; None if everything was.
    """

    image: Tensor
    alpha: Tensor
    means2d: Tensor
    moving: int
    index: Tensor | None = None
    tiles: Tensor | None = None

    def loss(self, target: Tensor, lambda_dssim: float, gain: Tensor | None) -> Tensor:
        """Of the whole picture."""
        return splat.photometric_loss(self.image, target, lambda_dssim, gain)


@dataclass(frozen=True)
class MovingTiles:
    """Moving splats before a view's static ones, only where they are: drawn when they are compared, and never as a whole picture.

    splats: the moving ones, and all static ones if `where` is given, [M] bool: then it is drawn only where one of those is.
    """

    splats: Splats
    static: StaticView
    background: Tensor | None
    moving: int
    where: Tensor | None = None

    @property
    def means2d(self) -> Tensor:
        return self.splats.means2d

    @property
    def index(self) -> Tensor | None:
        return None if self.where is None else self.static.index

    def loss(self, target: Tensor, lambda_dssim: float, gain: Tensor | None) -> Tensor:
        """Short of a constant: what is compared only where nothing moves is left out. The gain gets no gradient."""
        splats, frozen = self.splats.tensors, self.static.frozen
        return splat.layered_loss(*splats, frozen, target, lambda_dssim, gain, self.background, self.where)


def relative_distances(means: Tensor, views: list[View], unit: float, reach: float) -> Tensor:
    """[N] distances of points [N, 3] to the nearest view in typical viewing distances `unit`, 1 to `reach`.

    Farther points may go as much farther in a step, and be as much larger: in pixels it is the same at any distance.
    """
    centers = torch.stack([view.center for view in views])
    return (torch.cdist(means.detach(), centers).amin(1) / unit).clamp(1, reach)


def splats(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    sh: tuple[Tensor, Tensor],
    view: View,
    near: float,
) -> Splats:
    """Project points and evaluate their colors for a view. sh: [N, 1, 3] and [N, K - 1, 3]; other shapes as in `Gaussians`."""
    pinhole = view.viewmat, view.K, view.width, view.height
    projected = splat.project(means, quats, scales, *pinhole, near, view.antialias)
    colors = splat.view_colors(means, view.center, *sh)
    if view.antialias:
        opacities = splat.antialiased(opacities, projected.conics)
    seen = Splats(projected.means2d, projected.conics, colors, opacities, projected.depths, projected.radii)
    return seen.relative_to(view.background)


def deformed(
    params: dict[str, Tensor], offsets: tuple[Tensor, Tensor] | None, shade: Tensor | None, view: View, near: float
) -> Splats:
    """Points of one moment for a view. params: unconstrained, as `TrainablePoints` has them; offsets, shade: see `splat.deformed`."""
    pinhole = view.viewmat, view.K, view.width, view.height
    points = [params[name] for name in NAMES]
    seen = Splats(*splat.deformed(points, offsets, shade, pinhole, view.center, near, view.antialias))
    return seen.relative_to(view.background)


class StaticCache:
    """Static points, which do not change: each view projects, colors and draws them once and keeps the result."""

    def __init__(self, gaussians: Gaussians, views: list[View], near: float, device: torch.device) -> None:
        self.views = views
        self.near = near
        self.params = to_params(gaussians, device)
        self.alive = torch.ones(len(gaussians), dtype=torch.bool, device=device)
        self._views: dict[int, StaticView] = {}

    def __len__(self) -> int:
        return len(self.alive)

    @property
    def means(self) -> Tensor:
        return self.params["means"]

    def set_alive(self, alive: Tensor) -> None:
        """Hide the points that became dynamic. alive: [S] bool."""
        self.alive = alive.clone()
        self._views = {camera: view.keep(alive[view.index]) for camera, view in self._views.items()}

    def revive(self, alive: Tensor) -> None:
        """Show points again that were hidden. alive: [S] bool."""
        self.alive = alive
        self._views.clear()

    @torch.no_grad()
    def view(self, camera: int) -> StaticView:
        """The living points that view number `camera` sees."""
        if camera not in self._views:
            index = torch.nonzero(self.alive)[:, 0]
            points = activate({name: value[index] for name, value in self.params.items()})
            view = self.views[camera]
            projected = splats(*points, view, max(self.near, view.clear))
            seen = torch.nonzero(projected.radii > 0)[:, 0]
            shown, rows = projected.rows(seen), torch.arange(len(seen), device=seen.device)
            frozen = splat.freeze(*shown.tensors, view.width, view.height)
            self._views[camera] = StaticView(shown, index[seen], frozen, rows)
        return self._views[camera]

    def set_views(self, views: list[View]) -> None:
        """Be seen by other views from now on."""
        self.views = views
        self._views.clear()


def activate(params: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor, Tensor, tuple[Tensor, Tensor]]:
    """means, quats, scales, opacities and sh of unconstrained tensors, as `splats` takes them."""
    sh = params["sh_base"], params["sh_rest"]
    return params["means"], params["quats"], params["log_scales"].exp(), params["logit_opacities"].sigmoid(), sh


def draw(moving: Splats, view: View, static: StaticView | None = None, layered: bool = True) -> Drawing:
    """Rasterize moving points together with a view's static ones.

    layered: draw only the tiles that a moving point touches, and keep the static picture in the others. Picture and gradients of
    the moving points are the same; static ones get no gradient.
    """
    count = len(moving.means2d)
    parts = moving if static is None or layered else Splats.join(moving, static.splats)
    if parts.means2d.requires_grad:
        parts.means2d.retain_grad()
    if static is not None and layered:
        image, alpha, tiles = splat.rasterize_among(*parts.tensors, static.frozen)
        return Drawing(_add_background(view.background, image), alpha, parts.means2d, count, tiles=tiles)
    image, alpha = splat.rasterize(*parts.tensors, view.width, view.height)
    index = None if static is None else static.index
    return Drawing(_add_background(view.background, image), alpha, parts.means2d, count, index)


def moving_tiles(moving: Splats, view: View, static: StaticView, also: Tensor | None = None) -> MovingTiles:
    """As `draw`, of the tiles that a moving point touches, to be compared only.

    also: [S] bool, static points that get gradients too: the tiles are those where one of them is, or a moving one.
    """
    count, parts, where = len(moving.means2d), moving, None
    if also is not None:
        parts = Splats.join(moving, static.splats)
        where = torch.cat([also.new_ones(count), also[static.index]])
    if parts.means2d.requires_grad:
        parts.means2d.retain_grad()
    return MovingTiles(parts, static, view.background, count, where)


def _add_background(background: Tensor | None, image: Tensor) -> Tensor:
    """What differs from a background, added to it."""
    return image if background is None else image + background


def contributions(moving: Splats, view: View, static: StaticView) -> Tensor:
    """[N] how much of a view's picture every moving point fills, in pixels: its blending weights, summed."""
    marks = torch.zeros_like(moving.colors, requires_grad=True)
    marked = replace(moving, means2d=moving.means2d.detach().requires_grad_(), colors=marks)
    draw(marked, replace(view, background=None), static).image[..., 0].sum().backward()
    assert marks.grad is not None
    return marks.grad[:, 0]
