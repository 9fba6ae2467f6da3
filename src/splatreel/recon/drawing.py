"""Drawing the scene while it trains: moving points in front of and behind a frozen backdrop."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.recon.points import to_params
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians


@dataclass(frozen=True)
class View:
    """A camera as tensors. viewmat: [4, 4]; K: [3, 3]; center: [3]."""

    viewmat: Tensor
    K: Tensor
    center: Tensor
    width: int
    height: int

    @staticmethod
    def of(camera: Camera, device: torch.device) -> View:
        arrays = camera.viewmat, camera.K, camera.center
        viewmat, K, center = (torch.from_numpy(array.copy()).to(device) for array in arrays)
        return View(viewmat, K, center, camera.width, camera.height)


@dataclass(frozen=True)
class Splats:
    """Points as one view sees them, ready to be rasterized; fields as in `splat.rasterize`."""

    means2d: Tensor
    conics: Tensor
    colors: Tensor
    opacities: Tensor
    depths: Tensor
    radii: Tensor

    def rows(self, index: Tensor) -> Splats:
        """Those of an index [M] int64."""
        return Splats(*[getattr(self, f.name).index_select(0, index) for f in fields(self)])

    def spans(self, view: View) -> Tensor:
        """[M, 4]: the tiles each one touches."""
        return splat.tile_spans(self.means2d, self.conics, self.opacities, self.radii, view.width, view.height)

    @staticmethod
    def join(a: Splats, b: Splats) -> Splats:
        return Splats(*[torch.cat([getattr(a, f.name), getattr(b, f.name)]) for f in fields(a)])


@dataclass(frozen=True)
class Scenery:
    """What one view sees of the backdrop. index: [M] which of its points; spans: [M, 4] their tiles; image, alpha: their picture."""

    splats: Splats
    index: Tensor
    spans: Tensor
    image: Tensor
    alpha: Tensor


@dataclass(frozen=True)
class Drawing:
    """image: [H, W, 3]; alpha: [H, W]. means2d: [M, 2], a tensor of the graph that keeps its gradient (pixels).

    Its first `moving` rows are the moving points in their order, the others the backdrop's points `index`, whose gradient is zero
    in a layered drawing.
    """

    image: Tensor
    alpha: Tensor
    means2d: Tensor
    moving: int
    index: Tensor | None


def splats(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    sh: tuple[Tensor, Tensor],
    view: View,
    near: float,
) -> Splats:
    """Project points and evaluate their colours for a view. sh: [N, 1, 3] and [N, K - 1, 3]; other shapes as in `Gaussians`."""
    projected = splat.project(means, quats, scales, view.viewmat, view.K, view.width, view.height, near)
    colors = splat.view_colors(means, view.center, *sh)
    return Splats(projected.means2d, projected.conics, colors, opacities, projected.depths, projected.radii)


class Backdrop:
    """Static points: frozen, so that each view projects, colours and draws them once and keeps the result."""

    def __init__(self, gaussians: Gaussians, views: list[View], near: float, device: torch.device) -> None:
        self.views = views
        self.near = near
        self.params = to_params(gaussians, device)
        self.alive = torch.ones(len(gaussians), dtype=torch.bool, device=device)
        self._scenery: dict[int, Scenery] = {}

    def __len__(self) -> int:
        return len(self.alive)

    @property
    def means(self) -> Tensor:
        return self.params["means"]

    def set_alive(self, alive: Tensor) -> None:
        """Hide the points that became dynamic. alive: [S] bool."""
        self.alive = alive.clone()
        for camera, old in self._scenery.items():
            keep = torch.nonzero(alive[old.index])[:, 0]
            if len(keep) < len(old.index):
                self._scenery[camera] = self._drawn(camera, old.splats.rows(keep), old.index[keep])

    @torch.no_grad()
    def scenery(self, camera: int) -> Scenery:
        """The living points that view number `camera` sees."""
        if camera not in self._scenery:
            index = torch.nonzero(self.alive)[:, 0]
            points = activate({name: value[index] for name, value in self.params.items()})
            projected = splats(*points, self.views[camera], self.near)
            seen = torch.nonzero(projected.radii > 0)[:, 0]
            self._scenery[camera] = self._drawn(camera, projected.rows(seen), index[seen])
        return self._scenery[camera]

    @torch.no_grad()
    def _drawn(self, camera: int, seen: Splats, index: Tensor) -> Scenery:
        view = self.views[camera]
        image, alpha = _rasterize(seen, view)
        return Scenery(seen, index, seen.spans(view), image, alpha)


def activate(params: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor, Tensor, tuple[Tensor, Tensor]]:
    """means, quats, scales, opacities and sh of unconstrained tensors, as `splats` takes them."""
    sh = params["sh_base"], params["sh_rest"]
    return params["means"], params["quats"], params["log_scales"].exp(), params["logit_opacities"].sigmoid(), sh


def draw(moving: Splats, view: View, scenery: Scenery | None = None, layered: bool = True) -> Drawing:
    """Rasterize moving points together with a view's scenery.

    layered: draw only the tiles that a moving point touches, and keep the scenery's picture in the others. Picture and gradients of
    the moving points are the same; scenery gets no gradient, and outside of those tiles is not among the rows of means2d.
    """
    count = len(moving.means2d)
    if scenery is None:
        parts, index, still = moving, None, None
    elif layered:
        tiles = splat.touched_tiles(moving.spans(view), view.width, view.height)
        near_them = splat.touching(scenery.spans, tiles)
        parts, index = Splats.join(moving, scenery.splats.rows(near_them)), scenery.index[near_them]
        still = splat.Still(tiles, scenery.image, scenery.alpha)
    else:
        parts, index, still = Splats.join(moving, scenery.splats), scenery.index, None
    if parts.means2d.requires_grad:
        parts.means2d.retain_grad()
    image, alpha = _rasterize(parts, view, still, count if layered else None)
    return Drawing(image, alpha, parts.means2d, count, index)


def filled(moving: Splats, view: View, scenery: Scenery) -> Tensor:
    """[N] how much of a view's picture every moving point fills, in pixels: its blending weights, summed."""
    marks = torch.zeros_like(moving.colors, requires_grad=True)
    marked = replace(moving, means2d=moving.means2d.detach().requires_grad_(), colors=marks)
    draw(marked, view, scenery).image[..., 0].sum().backward()
    assert marks.grad is not None
    return marks.grad[:, 0]


def _rasterize(
    s: Splats, view: View, still: splat.Still | None = None, learning: int | None = None
) -> tuple[Tensor, Tensor]:
    arrays = s.means2d, s.conics, s.colors, s.opacities, s.depths, s.radii
    return splat.rasterize(*arrays, view.width, view.height, still, learning)
