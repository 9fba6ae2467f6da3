"""Lifting of 2D motion masks to a label per Gaussian (paper section 4.1, 3D lifting)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from splatreel.base.errors import ReconstructionError
from splatreel.config import LayeringConfig
from splatreel.kernels import splat
from splatreel.kernels.projected import Projection
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians


class SplatTensors(NamedTuple):
    """Points without colors: means [N, 3], quats [N, 4], scales [N, 3] and opacities [N]."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor

    @classmethod
    def of(cls, points: Gaussians, device: torch.device | str = "cpu") -> SplatTensors:
        """Convert points. On the CPU the tensors share their memory."""
        arrays = (points.means, points.quats, points.scales, points.opacities)
        return cls(*(torch.from_numpy(array).to(device) for array in arrays))


LEAST_CONTRIBUTION = 0.05
"""Minimum contribution over all cameras, pixels, for a point to count as seen."""
LIFT_RATE = 0.05
ITERATIONS = 400
"""Iterations of the paper's lifting, one view each: twenty per view for twenty cameras. Fewer leave labels between 0 and 1."""
NEIGHBORS = 8
"""Number of neighbors whose labels count too; the paper's value (section 5.1)."""
DYNAMIC_LABEL = 0.5
"""Labels above this value are dynamic: the middle of 0 (static) and 1. A lower value makes more points dynamic, which costs
bytes."""


class _Contributions(NamedTuple):
    """inside: [N] contribution of each point to masked pixels over all cameras, pixels; total: [N] to all pixels."""

    inside: Tensor
    total: Tensor

    @property
    def seen(self) -> Tensor:
        return self.total > LEAST_CONTRIBUTION

    @property
    def share(self) -> Tensor:
        """Share of each point's contribution that lies in the masks, [N]."""
        return self.inside / self.total.clamp_min(LEAST_CONTRIBUTION)


def lift(
    points: Gaussians,
    cameras: list[Camera],
    masks: np.ndarray,
    near: float,
    config: LayeringConfig,
    device: torch.device | str = "cpu",
) -> np.ndarray:
    """Return a motion label per point, [N] float32 in 0..1. A label above `DYNAMIC_LABEL` is dynamic; points that no camera sees get 0.

    Args:
        points: N points.
        cameras: All cameras.
        masks: [C, H, W] bool, of the cameras' size.
        near: Near plane, world units.
        config: Layering settings.
        device: Device on which points are drawn.

    Raises:
        ReconstructionError: If masks and cameras do not match.
    """
    expected = [(c.height, c.width) for c in cameras]
    if len(masks) != len(cameras) or any(m.shape != s for m, s in zip(masks, expected, strict=True)):
        raise ReconstructionError(
            f"Lifting: masks {masks.shape} do not match the sizes of the {len(cameras)} cameras, {expected}."
        )
    if len(points) == 0 or not masks.any():
        return np.zeros(len(points), np.float32)
    splats = SplatTensors.of(points, device)
    targets = torch.from_numpy(np.asarray(masks, np.float32)).to(device)
    weights = _contributions(splats, cameras, targets, near)
    by_vote = config.lift == "vote"
    labels = _vote(splats.means, weights, NEIGHBORS) if by_vote else _minimize(splats, cameras, targets, near, config)
    return torch.where(weights.seen, labels, 0).cpu().numpy().astype(np.float32)


def shares(
    points: Gaussians, cameras: list[Camera], masks: np.ndarray, near: float, device: torch.device | str = "cpu"
) -> np.ndarray:
    """Return the share of each point's contribution that lies in masks, [N] 0..1; NaN where no camera sees the point.

    Args:
        points: N points.
        cameras: All cameras.
        masks: [C, H, W] bool.
        near: Near plane, world units.
        device: Device on which points are drawn.
    """
    if len(points) == 0:
        return np.zeros(0, np.float32)
    weights = _contributions(SplatTensors.of(points, device), cameras, torch.from_numpy(masks).float().to(device), near)
    return torch.where(weights.seen, weights.share, torch.nan).cpu().numpy()


def gather_images(splats: SplatTensors, camera: Camera, images: Tensor, near: float) -> Tensor:
    """Return the sum of images [H, W, K] over the pixels of each point, [N, K], weighted by the point's share of every pixel.

    Args:
        splats: N points.
        camera: Camera of the images.
        images: [H, W, K].
        near: Near plane, world units.
    """
    return splat.gather(_project(splats, camera, near), splats.opacities, images)


def _contributions(splats: SplatTensors, cameras: list[Camera], masks: Tensor, near: float) -> _Contributions:
    sums = torch.zeros(len(splats.means), 2, device=masks.device)
    for camera, mask in zip(cameras, masks, strict=True):
        sums += gather_images(splats, camera, torch.stack([mask, torch.ones_like(mask)], -1), near)
    return _Contributions(sums[:, 0], sums[:, 1])


def _draw(splats: SplatTensors, colors: Tensor, camera: Camera, near: float) -> Tensor:
    """Blend colors [N, C] to an image [H, W, C]. Only the colors get gradients."""
    seen = _project(splats, camera, near).colored(colors, splats.opacities)
    return splat.rasterize(seen, camera.width, camera.height)[0]


@torch.no_grad()
def _project(splats: SplatTensors, camera: Camera, near: float) -> Projection:
    view = camera.viewmat, camera.K, camera.width, camera.height
    return splat.project(splats.means, splats.quats, splats.scales, *view, near)


def _vote(means: Tensor, weights: _Contributions, neighbors: int) -> Tensor:
    """Return the share [N] of each point's contribution that lies in the masks, averaged with its nearest seen neighbors."""
    seen = weights.seen
    votes = torch.where(seen, weights.share, 0)
    count = min(neighbors, len(means) - 1)
    if count < 1:
        return votes
    index = splat.nearest_neighbors(means, count)[0]
    around = torch.cat([torch.arange(len(means), device=means.device)[:, None], index], 1)
    return votes[around].sum(1) / seen[around].sum(1).clamp_min(1)


def _minimize(
    splats: SplatTensors, cameras: list[Camera], masks: Tensor, near: float, config: LayeringConfig
) -> Tensor:
    """Return the labels [N] that minimize the paper's L_m, by one random view per iteration.

    The sums over points are divided by the number of views, since each iteration has only one view's share of the first term.
    """
    rng = np.random.default_rng(0)
    count = len(splats.means)
    labels = torch.full((count,), 0.5, device=splats.means.device, requires_grad=True)
    nearest = splat.nearest_neighbors(splats.means, 1)[0][:, 0] if count > 1 else torch.zeros(1, dtype=torch.int64)
    optimizer = torch.optim.Adam([labels], lr=LIFT_RATE)
    for iteration in range(ITERATIONS):
        view = int(rng.integers(len(cameras)))
        rendered = _draw(splats, labels[:, None], cameras[view], near)[..., 0]
        alike = (labels - labels[nearest]).abs().sum()
        moving = (labels - 1).abs().sum()
        loss = (rendered - masks[view]).abs().sum()
        loss = loss + (config.lambda_nn * alike + config.lambda_dyn * moving) / len(cameras)
        optimizer.param_groups[0]["lr"] = LIFT_RATE * 0.1 ** (iteration / ITERATIONS)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        with torch.no_grad():
            labels.clamp_(0, 1)
    return labels.detach()
