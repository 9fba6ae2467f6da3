"""How much of the pictures hangs on each point: what the encoder spends its bits by."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch

from splatreel.codec.header import ReelHeader
from splatreel.config import EncodeConfig
from splatreel.kernels import splat
from splatreel.recon.cameras.group_input import ENOUGH_SIDE
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

VIEWS = 24
"""Pictures of a moment that are looked at, at most."""
GROUP_MOMENTS, GROUP_VIEWS = 32, 2
"""Times of a group at which the importance of its points is looked at, and pictures at each: what shows for a few frames shows."""

Importance = tuple[np.ndarray | None, np.ndarray | None]
"""Of a group's dynamic points [N, 3], and of all static points so far [S, 3]; None where the codec has no use for it."""


def group_importance(
    reel: ReelHeader, config: EncodeConfig, static: Gaussians, group: Group, device: torch.device
) -> Importance:
    """What `weigh` says of the points of a group over its frames. static: all that `group.alive` speaks of, in that order.

    Nothing hangs on static points that are not alive.
    """
    if config.codec == "h265" and not (config.h265.weighted_codebook and config.sh_entries):
        return None, None
    times = np.linspace(0, group.frames - 1, min(GROUP_MOMENTS, group.frames))
    moments = (Gaussians.concatenate([group.at(time), static[group.alive]]) for time in times)
    found = weigh(moments, list(reel.cameras), reel.near, device, reel.antialias, GROUP_VIEWS)
    resting = np.zeros((len(static), 3), np.float32)
    resting[group.alive] = found[len(group.dynamic) :]
    return found[: len(group.dynamic)], resting


def weigh(
    moments: Iterable[Gaussians],
    cameras: list[Camera],
    near: float,
    device: torch.device,
    antialias: bool = False,
    views: int = VIEWS,
) -> np.ndarray:
    """[N, 3] float32: how much the pictures change with a point's shape (its log scales), its color and its place (world units).

    moments: the same N points at some times, each seen by `views` of the cameras at most. Large pictures are drawn smaller, and count
    as large as they are. device: where they are drawn. Root of the summed squares over all pixels of the derivatives, estimated: the
    gradient of a picture weighted by random signs has that sum as its expected square (Hutchinson's estimator).
    """
    rng = np.random.default_rng(0)
    squares: np.ndarray | float = 0.0
    smaller = [camera.at_most(ENOUGH_SIDE) for camera in cameras]
    apart = max(len(cameras) // views, 1)
    for number, points in enumerate(moments):
        # Every moment is seen by other cameras, spread over all of them.
        for camera, drawn in list(zip(cameras, smaller, strict=True))[number % apart :: apart][:views]:
            pixels = camera.width * camera.height / (drawn.width * drawn.height)
            squares = squares + pixels * _squares(points, drawn, near, device, antialias, rng)
    return np.sqrt(squares).astype(np.float32)


def _squares(
    points: Gaussians, camera: Camera, near: float, device: torch.device, antialias: bool, rng: np.random.Generator
) -> np.ndarray:
    arrays = points.means, points.quats, points.scales, points.opacities, points.sh
    means, quats, scales, opacities, sh = (torch.from_numpy(array).to(device) for array in arrays)
    for tensor in (means, scales, sh):
        tensor.requires_grad_()
    size = camera.width, camera.height
    view, how = (camera.viewmat, camera.K, *size), {"near": near, "antialias": antialias}
    image = splat.render(means, quats, scales, opacities, sh, *view, **how).image
    signs = torch.from_numpy(rng.choice(np.array([-1, 1], np.float32), image.shape)).to(device)
    of_scales, of_sh, of_means = torch.autograd.grad((image * signs).sum(), (scales, sh, means))
    gradients = of_scales * scales.detach(), of_sh[:, 0], of_means
    return np.stack([gradient.square().sum(1).cpu().numpy() for gradient in gradients], 1)
