"""Drawing the scene while it trains: moving points in front of and behind a frozen backdrop."""

from __future__ import annotations

from dataclasses import dataclass

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
        tensors = [torch.from_numpy(array.copy()).to(device) for array in (camera.viewmat, camera.K, camera.center)]
        return View(*tensors, camera.width, camera.height)


@dataclass(frozen=True)
class Splats:
    """Points as one view sees them, ready to be rasterized. index: [M] which points they are, None for all."""

    means2d: Tensor
    conics: Tensor
    colors: Tensor
    opacities: Tensor
    depths: Tensor
    radii: Tensor
    index: Tensor | None = None


@dataclass(frozen=True)
class Drawing:
    """image: [H, W, 3]; alpha: [H, W]. means2d: [M, 2], a tensor of the graph that keeps its gradient (pixels).

    Its first `moving` rows are the moving points in their order, the others the backdrop's points `index`.
    """

    image: Tensor
    alpha: Tensor
    means2d: Tensor
    moving: int
    index: Tensor | None


def splats(
    means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, sh: Tensor, view: View, near: float
) -> Splats:
    """Project points and evaluate their colours for a view. Shapes as in `Gaussians`."""
    projected = splat.project(means, quats, scales, view.viewmat, view.K, view.width, view.height, near)
    degree = round(sh.shape[1] ** 0.5) - 1
    colors = (splat.spherical_harmonics(degree, means.detach() - view.center, sh) + 0.5).clamp_min(0)
    return Splats(projected.means2d, projected.conics, colors, opacities, projected.depths, projected.radii)


class Backdrop:
    """Static points: frozen, so that each view projects and colours them once and keeps the result."""

    def __init__(self, gaussians: Gaussians, views: list[View], near: float, device: torch.device) -> None:
        self.views = views
        self.near = near
        self.params = to_params(gaussians, device)
        self._points = activate(self.params)
        self.alive = torch.ones(len(gaussians), dtype=torch.bool, device=device)
        self._seen: dict[int, Splats] = {}

    def __len__(self) -> int:
        return len(self.alive)

    @property
    def means(self) -> Tensor:
        return self.params["means"]

    def set_alive(self, alive: Tensor) -> None:
        """Hide the points that became dynamic. alive: [S] bool."""
        self.alive = alive.clone()
        for camera, seen in self._seen.items():
            if seen.index is not None:
                self._seen[camera] = _select(seen, alive[seen.index])

    def seen(self, camera: int) -> Splats:
        """The living points that view number `camera` sees."""
        if camera not in self._seen:
            with torch.no_grad():
                index = torch.nonzero(self.alive)[:, 0]
                all_points = splats(*(array[index] for array in self._points), self.views[camera], self.near)
                named = Splats(*(getattr(all_points, n) for n in _FIELDS), index)
                self._seen[camera] = _select(named, all_points.radii > 0)
        return self._seen[camera]


def activate(params: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """means, quats, scales, opacities and sh of unconstrained tensors."""
    sh = torch.cat([params["sh_base"], params["sh_rest"]], 1)
    return params["means"], params["quats"], params["log_scales"].exp(), params["logit_opacities"].sigmoid(), sh


_FIELDS = ("means2d", "conics", "colors", "opacities", "depths", "radii")


def _select(seen: Splats, mask: Tensor) -> Splats:
    assert seen.index is not None
    return Splats(*(getattr(seen, name)[mask] for name in _FIELDS), seen.index[mask])


def draw(moving: Splats, view: View, backdrop: Splats | None = None) -> Drawing:
    """Rasterize moving points together with a view's backdrop."""
    count = len(moving.means2d)
    parts = moving if backdrop is None else _join(moving, backdrop)
    means2d = parts.means2d
    if means2d.requires_grad:
        means2d.retain_grad()
    image, alpha = splat.rasterize(
        means2d, parts.conics, parts.colors, parts.opacities, parts.depths, parts.radii, view.width, view.height
    )
    return Drawing(image, alpha, means2d, count, None if backdrop is None else backdrop.index)


def _join(moving: Splats, backdrop: Splats) -> Splats:
    return Splats(*(torch.cat([getattr(moving, name), getattr(backdrop, name)]) for name in _FIELDS))
