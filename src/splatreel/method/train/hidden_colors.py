"""Colors of points that the training views hardly see.

Few cameras leave much of a surface unseen, or see it along its edge. The color of a point there fits a few mixed pixels, and a
novel view shows it at full size. Such a point takes the color of the points around it instead.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.method.train.render import StaticCache, contributions, deformed
from splatreel.method.train.trainable_points import TrainablePoints
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import C0

SEEN = 0.3
"""Share of a point's broad side that a view must show for its color to count in full."""
NEIGHBORS, PASSES = 12, 4
"""Number of nearest points that a color is taken from, and of passes by which colors spread."""
LEAST = 1e-4
"""Weight of a point that no view shows, as a share of one that a view shows."""


@torch.no_grad()
def spread_colors(points: TrainablePoints, images: TrainingImages, static: StaticCache | None) -> None:
    """Give points that no view shows well the mean color of their neighbors. It depends on the view as little as they are seen.

    Args:
        points: Points, whose colors are changed.
        images: Training images of a keyframe.
        static: Static points; None if there are none.
    """
    count = min(NEIGHBORS + 1, len(points) - 1)
    if count < 1:
        return
    params = points.params
    own = (seen_shares(points, images, static) / SEEN).clamp(0, 1).square()
    index, distance = splat.nearest_neighbors(points.means.detach(), count)
    closeness = 1 / (distance + distance[:, 0].median().clamp_min(1e-9))
    base = params["sh_base"][:, 0].clone()
    known, color = own, base
    for _ in range(PASSES):
        weight = (known[index] + LEAST) * closeness
        around = (weight[..., None] * color[index]).sum(1) / weight.sum(1, keepdim=True)
        color = torch.lerp(around, base, own[:, None])
        known = torch.maximum(own, known[index].mean(1) / 2)
    params["sh_base"][:, 0] = color
    params["sh_rest"].mul_(own[:, None, None])


def seen_shares(points: TrainablePoints, images: TrainingImages, static: StaticCache | None) -> Tensor:
    """Return how much of each point's broad side is shown, [N]: the largest share over the views, 0..1.

    Args:
        points: Points.
        images: Training images of a keyframe.
        static: Static points in front of some of them; None if there are none.
    """
    _, middle, broad = points.scales.detach().sort(1).values.unbind(1)
    found = torch.zeros_like(middle)
    for camera, view in enumerate(images.views):
        splats = deformed(points.params, None, None, view, images.near)
        with torch.enable_grad():
            shown = contributions(splats, view, None if static is None else static.view(camera))
        size = view.K[0, 0] / splats.depths.clamp_min(images.near)
        area = 2 * math.pi * ((middle * size).square() + 0.1).sqrt() * ((broad * size).square() + 0.1).sqrt()
        found = torch.maximum(found, shown / (points.opacities.detach() * area).clamp_min(1e-6))
    return found.clamp_max(1)


def bound_colors(points: TrainablePoints) -> None:
    """Keep the constant part of all colors within 0..1."""
    with torch.no_grad():
        points.params["sh_base"].clamp_(-0.5 / C0, 0.5 / C0)
