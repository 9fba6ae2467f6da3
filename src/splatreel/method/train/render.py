"""Drawing during training. Static points are projected and sorted once per view, then combined with moving points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.kernels.projected import FrozenSplats, Splats
from splatreel.method.init.layout import Layout
from splatreel.method.train.trainable_points import NAMES, to_params
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians


@dataclass(frozen=True)
class View:
    """A camera as tensors.

    Attributes:
        viewmat: [4, 4] world to camera.
        K: [3, 3] intrinsics, pixels.
        center: [3] camera position, world units.
        width: Image width, pixels.
        height: Image height, pixels.
        antialias: Draw as `splat.antialiased` describes.
        clear: Depth up to which no static point is drawn (`Clearance`), world units.
        background: [3] color behind all points, 0..1; None is black.
        gain: [3] color gain of the camera that the background is divided by; None if the gain changes the background too.
    """

    viewmat: Tensor
    K: Tensor
    center: Tensor
    width: int
    height: int
    antialias: bool = False
    clear: float = 0.0
    background: Tensor | None = None
    gain: Tensor | None = None

    @staticmethod
    def of(
        camera: Camera,
        device: torch.device,
        antialias: bool = False,
        layout: Layout | None = None,
        gain: Tensor | None = None,
    ) -> View:
        """Convert a camera. A layout adds clearance and background. `gain` is the camera's color gain [3]; None is 1."""
        arrays = camera.viewmat, camera.K, camera.center
        viewmat, K, center = (torch.from_numpy(array.copy()).to(device) for array in arrays)
        plain = View(viewmat, K, center, camera.width, camera.height, antialias)
        if layout is None:
            return plain
        gain = torch.ones(3, device=device) if gain is None else gain.clone()
        color = layout.background_of(camera, gain.cpu().numpy())
        background = torch.tensor(color, dtype=torch.float32, device=device) if any(color) else None
        plain = replace(plain, clear=layout.clearance.depth(camera), background=background)
        return replace(plain, gain=gain) if layout.backgrounds else plain

    def halved(self) -> View:
        """Return the view of images at half size (`halved`)."""
        K = self.K.clone()
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
    index: Tensor
    frozen: FrozenSplats
    rows: Tensor

    def keep(self, kept: Tensor) -> StaticView:
        """Return the view with the points of a mask [M] bool only."""
        if bool(kept.all()):
            return self
        index, frozen = torch.nonzero(kept)[:, 0], splat.remove(self.frozen, self.rows[~kept])
        return StaticView(self.splats.rows(index), self.index[index], frozen, self.rows[index])


class Comparable(Protocol):
    """A drawing that can be compared with a training image."""

    @property
    def means2d(self) -> Tensor:
        """Screen positions [M, 2], pixels: a tensor of the graph that keeps its gradient."""
        ...

    @property
    def moving(self) -> int:
        """Number of moving points. They are the first rows of `means2d`."""
        ...

    @property
    def index(self) -> Tensor | None:
        """Static points of the remaining rows of `means2d`; None if static points get no gradient."""
        ...

    @property
    def absolute(self) -> Tensor | None:
        """Tensor [moving, 2] whose gradient is the absolute gradient of `splat.rasterize`; None if it is not measured."""
        ...

    def loss(self, target: Tensor, lambda_dssim: float, gain: Tensor | None) -> Tensor:
        """Return the photometric loss [] against an image [H, W, 3] uint8 of a camera with a color gain [3]."""
        ...


@dataclass(frozen=True)
class Drawing:
    """A complete drawing of a view.

    Attributes:
        image: [H, W, 3] colors.
        alpha: [H, W] opacity.
        means2d: See `Comparable`.
        moving, index, absolute: See `Comparable`.
        tiles: [ceil(H / 16), ceil(W / 16)] bool, tiles that were drawn with gradients; None if all were.
    """

    image: Tensor
    alpha: Tensor
    means2d: Tensor
    moving: int
    index: Tensor | None = None
    absolute: Tensor | None = None
    tiles: Tensor | None = None

    def loss(self, target: Tensor, lambda_dssim: float, gain: Tensor | None) -> Tensor:
        """Return the photometric loss over the whole image; see `Comparable.loss`."""
        return splat.photometric_loss(self.image, target, lambda_dssim, gain)


@dataclass(frozen=True)
class MovingTiles:
    """Moving splats in front of a view's static ones, drawn during the comparison and only in the tiles they touch.

    Attributes:
        splats: The moving splats; all static splats follow if `where` is given.
        static: The view's static splats.
        background: [3] color behind all points; None is black.
        moving: Number of moving splats.
        where: [M] bool, splats whose tiles are drawn; None draws the tiles of moving splats.
    """

    splats: Splats
    static: StaticView
    background: Tensor | None
    moving: int
    where: Tensor | None = None
    absolute: None = None

    @property
    def means2d(self) -> Tensor:
        """See `Comparable`."""
        return self.splats.means2d

    @property
    def index(self) -> Tensor | None:
        """See `Comparable`."""
        return None if self.where is None else self.static.index

    def loss(self, target: Tensor, lambda_dssim: float, gain: Tensor | None) -> Tensor:
        """Return the photometric loss, up to a constant for the tiles that are not drawn. The gain gets no gradient."""
        frozen = self.static.frozen
        return splat.layered_loss(self.splats, frozen, target, lambda_dssim, gain, self.background, self.where)


def relative_distances(means: Tensor, views: list[View], unit: float, reach: float) -> Tensor:
    """Return the distance [N] of points to the nearest view, in viewing distances, clamped to 1..reach.

    Step sizes and size limits of far points are scaled by it. In pixels they are then the same at any distance.

    Args:
        means: [N, 3] positions.
        views: Training views.
        unit: Typical viewing distance, world units.
        reach: Largest distance returned.
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
    """Project points and evaluate their colors for a view.

    Args:
        means: [N, 3] positions.
        quats: [N, 4] rotations.
        scales: [N, 3] standard deviations.
        opacities: [N] 0..1.
        sh: Constant part [N, 1, 3] and higher bands [N, K - 1, 3].
        view: View to project to.
        near: Near plane, world units.
    """
    pinhole = view.viewmat, view.K, view.width, view.height
    projected = splat.project(means, quats, scales, *pinhole, near, view.antialias)
    colors = splat.view_colors(means, view.center, *sh)
    if view.antialias:
        opacities = splat.antialiased(opacities, projected.conics)
    return projected.colored(colors, opacities).relative_to(view.background)


def deformed(
    params: dict[str, Tensor], offsets: tuple[Tensor, Tensor] | None, shade: Tensor | None, view: View, near: float
) -> Splats:
    """Project deformed points for a view.

    Args:
        params: Unconstrained tensors, as in `TrainablePoints`.
        offsets: Change of positions and rotations, see `splat.deformed`; None for none.
        shade: Change of color and opacity, see `splat.deformed`; None for none.
        view: View to project to.
        near: Near plane, world units.
    """
    pinhole = view.viewmat, view.K, view.width, view.height
    points = [params[name] for name in NAMES]
    seen = splat.deformed(points, offsets, shade, pinhole, view.center, near, view.antialias)
    return seen.relative_to(view.background)


class StaticCache:
    """Frozen static points. Each view projects, colors and sorts them once."""

    def __init__(self, gaussians: Gaussians, views: list[View], near: float, device: torch.device) -> None:
        """Store static points, all of them living.

        Args:
            gaussians: S static points.
            views: Views to draw.
            near: Near plane, world units.
            device: Device of the tensors.
        """
        self.views = views
        self.near = near
        self.params = to_params(gaussians, device)
        self.alive = torch.ones(len(gaussians), dtype=torch.bool, device=device)
        self._views: dict[int, StaticView] = {}

    def __len__(self) -> int:
        """Return the number of points, hidden ones included."""
        return len(self.alive)

    @property
    def means(self) -> Tensor:
        """Positions [S, 3]."""
        return self.params["means"]

    def set_alive(self, alive: Tensor) -> None:
        """Hide points that became dynamic. alive: [S] bool, a subset of the points that are alive now."""
        self.alive = alive.clone()
        self._views = {camera: view.keep(alive[view.index]) for camera, view in self._views.items()}

    def revive(self, alive: Tensor) -> None:
        """Replace the mask of living points, [S] bool. Unlike `set_alive`, it may show hidden points again."""
        self.alive = alive
        self._views.clear()

    @torch.no_grad()
    def view(self, camera: int) -> StaticView:
        """Return the living points that view number `camera` sees."""
        if camera not in self._views:
            index = torch.nonzero(self.alive)[:, 0]
            points = activate({name: value[index] for name, value in self.params.items()})
            view = self.views[camera]
            projected = splats(*points, view, max(self.near, view.clear))
            seen = torch.nonzero(projected.radii > 0)[:, 0]
            shown, rows = projected.rows(seen), torch.arange(len(seen), device=seen.device)
            frozen = splat.freeze(shown, view.width, view.height)
            self._views[camera] = StaticView(shown, index[seen], frozen, rows)
        return self._views[camera]

    def set_views(self, views: list[View]) -> None:
        """Replace the views."""
        self.views = views
        self._views.clear()


def activate(params: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor, Tensor, tuple[Tensor, Tensor]]:
    """Convert unconstrained tensors to the means, quats, scales, opacities and sh that `splats` takes."""
    sh = params["sh_base"], params["sh_rest"]
    return params["means"], params["quats"], params["log_scales"].exp(), params["logit_opacities"].sigmoid(), sh


def draw(moving: Splats, view: View, static: StaticView | None = None, layered: bool = True) -> Drawing:
    """Rasterize moving points together with a view's static ones.

    Args:
        moving: Moving splats.
        view: View to draw.
        static: The view's static splats; None draws the moving ones only.
        layered: Draw only tiles that a moving point touches, and copy the static image elsewhere. The image and the gradients
            of the moving points are the same; static points get no gradient.
    """
    count = len(moving.means2d)
    parts = moving if static is None or layered else Splats.join(moving, static.splats)
    if parts.means2d.requires_grad:
        parts.means2d.retain_grad()
    if static is not None and layered:
        image, alpha, tiles = splat.rasterize_among(parts, static.frozen)
        return Drawing(_add_background(view.background, image), alpha, parts.means2d, count, tiles=tiles)
    absolute = torch.zeros_like(parts.means2d, requires_grad=parts.means2d.requires_grad) if static is None else None
    image, alpha = splat.rasterize(parts, view.width, view.height, absolute)
    index = None if static is None else static.index
    return Drawing(_add_background(view.background, image), alpha, parts.means2d, count, index, absolute)


def moving_tiles(moving: Splats, view: View, static: StaticView, also: Tensor | None = None) -> MovingTiles:
    """Prepare a comparison of the tiles that moving points touch.

    Args:
        moving: Moving splats.
        view: View to draw.
        static: The view's static splats.
        also: [S] bool, static points that get gradients and whose tiles are drawn too; None for none.
    """
    count, parts, where = len(moving.means2d), moving, None
    if also is not None:
        parts = Splats.join(moving, static.splats)
        where = torch.cat([also.new_ones(count), also[static.index]])
    if parts.means2d.requires_grad:
        parts.means2d.retain_grad()
    return MovingTiles(parts, static, view.background, count, where)


def _add_background(background: Tensor | None, image: Tensor) -> Tensor:
    """Add the background to an image that was blended relative to it."""
    return image if background is None else image + background


def contributions(moving: Splats, view: View, static: StaticView | None) -> Tensor:
    """Return the pixels that every moving point fills in a view, [N]: the sum of its blending weights."""
    marks = torch.zeros_like(moving.colors, requires_grad=True)
    marked = moving._replace(means2d=moving.means2d.detach().requires_grad_(), colors=marks)
    draw(marked, replace(view, background=None), static).image[..., 0].sum().backward()
    assert marks.grad is not None
    return marks.grad[:, 0]
