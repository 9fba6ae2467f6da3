"""Importance of points: how much the images depend on each. The encoder distributes bits by it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch

from splatreel.codec.header import ReelHeader
from splatreel.config import EncodeConfig
from splatreel.kernels import splat
from splatreel.method.cameras.group_input import ENOUGH_SIDE
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

VIEWS = 24
"""Maximum number of views drawn per moment."""
GROUP_MOMENTS, GROUP_VIEWS = 32, 2
"""Moments of a group at which importance is measured, and views drawn at each. Points that show only for a few frames count
too."""

Importance = tuple[np.ndarray | None, np.ndarray | None]
"""Importance of a group's dynamic points [N, 3], and of all static points so far [S, 3]; None where the codec does not use it."""


def group_importance(
    reel: ReelHeader, config: EncodeConfig, static: Gaussians, group: Group, device: torch.device
) -> Importance:
    """Measure the importance of a group's points over its frames.

    Args:
        reel: Header of the reel.
        config: Settings of the encoder.
        static: All static points that `group.alive` refers to. Those that are not alive have importance 0.
        group: The group.
        device: Device on which views are drawn.
    """
    if config.codec == "h265" and not (config.h265.weighted_codebook and config.sh_entries):
        return None, None
    times = np.linspace(0, group.frames - 1, min(GROUP_MOMENTS, group.frames))
    moments = (Gaussians.concatenate([group.at(time), static[group.alive]]) for time in times)
    found = weigh(moments, list(reel.cameras), reel.near, device, reel.antialias, GROUP_VIEWS)
    of_static = np.zeros((len(static), 3), np.float32)
    of_static[group.alive] = found[len(group.dynamic) :]
    return found[: len(group.dynamic)], of_static


def weigh(
    moments: Iterable[Gaussians],
    cameras: list[Camera],
    near: float,
    device: torch.device,
    antialias: bool = False,
    views: int = VIEWS,
) -> np.ndarray:
    """Return the importance [N, 3] float32 of points: of their shape (log scales), color and position (world units).

    Importance is the root of the summed squared derivatives of all pixels. Hutchinson's estimator gives it: the gradient of an
    image weighted by random signs has that sum as its expected square. Large images are drawn smaller and weighted by their
    size.

    Args:
        moments: The same N points at several moments.
        cameras: Cameras to draw.
        near: Near plane, world units.
        device: Device on which views are drawn.
        antialias: See `View`.
        views: Maximum number of cameras drawn per moment.
    """
    rng = np.random.default_rng(0)
    squares: np.ndarray | float = 0.0
    smaller = [camera.at_most(ENOUGH_SIDE) for camera in cameras]
    apart = max(len(cameras) // views, 1)
    for number, points in enumerate(moments):
        # Every moment uses other cameras, spread over all of them.
        for camera, drawn in list(zip(cameras, smaller, strict=True))[number % apart :: apart][:views]:
            pixels = camera.width * camera.height / (drawn.width * drawn.height)
            squares = squares + pixels * _squares(points, drawn, near, device, antialias, rng)
    return np.sqrt(squares).astype(np.float32)


def _squares(
    points: Gaussians, camera: Camera, near: float, device: torch.device, antialias: bool, rng: np.random.Generator
) -> np.ndarray:
    """Return one sample of the squared derivatives, [N, 3]."""
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
