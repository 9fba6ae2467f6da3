"""Lifting of 2D motion masks to a label per Gaussian (paper section 4.1, 3D lifting)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splatreel.base import threads
from splatreel.base.errors import ReconstructionError
from splatreel.config import LayeringConfig
from splatreel.kernels import adam, rasterize, splat
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

LEAST_CONTRIBUTION = 0.05
"""Minimum contribution over all cameras, pixels, for a point to count as seen."""
LIFT_RATE = 0.05
ITERATIONS = 400
"""Iterations of the paper's lifting, one view each: twenty per view for twenty cameras. Fewer leave labels between 0 and 1."""
NEIGHBORS = 8
"""Number of neighbors whose labels count too; the paper's value (section 5.1)."""
LAMBDA_NN, LAMBDA_DYN = 0.5, 0.3
"""Weights of different labels of neighbors and of dynamic labels in the paper's lifting (lambda_seg^nn, lambda_seg^dyn)."""


class _Contributions(NamedTuple):
    """inside: [N] contribution of each point to masked pixels over all cameras, pixels; total: [N] to all pixels."""

    inside: np.ndarray
    total: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        return self.total > LEAST_CONTRIBUTION

    @property
    def share(self) -> np.ndarray:
        """Share of each point's contribution that lies in the masks, [N]."""
        return self.inside / np.maximum(self.total, LEAST_CONTRIBUTION)


def lift(
    points: Gaussians, cameras: list[Camera], masks: np.ndarray, near: float, config: LayeringConfig
) -> np.ndarray:
    """Return a motion label per point, [N] float32: 0 is static or unseen, 1 dynamic. `labels.DYNAMIC_LABEL` is between.

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
    weights = _contributions(points, cameras, masks, near)
    by_vote = config.lift == "vote"
    labels = _vote(points.means, weights, NEIGHBORS) if by_vote else _minimize(points, cameras, masks, near, config)
    return np.where(weights.seen, labels, np.float32(0))


def shares(points: Gaussians, cameras: list[Camera], masks: np.ndarray, near: float) -> np.ndarray:
    """Return the share of each point's contribution that lies in masks, [N] float32 0..1; NaN where no camera sees the point."""
    if len(points) == 0:
        return np.zeros(0, np.float32)
    weights = _contributions(points, cameras, masks, near)
    return np.where(weights.seen, weights.share, np.float32(np.nan))


def gather_images(points: Gaussians, camera: Camera, images: np.ndarray, near: float) -> np.ndarray:
    """Return the sum of images [H, W, K] over the pixels of each point, [N, K], weighted by the point's share of every pixel."""
    return splat.gather(_project(points, camera, near), points.opacities, images)


def _contributions(points: Gaussians, cameras: list[Camera], masks: np.ndarray, near: float) -> _Contributions:

    def of_view(view: int) -> np.ndarray:
        images = np.stack([masks[view], np.ones_like(masks[view])], -1).astype(np.float32)
        return gather_images(points, cameras[view], images, near)

    sums = np.zeros((len(points), 2), np.float32)
    for found in threads.map_parallel(of_view, range(len(cameras))):  # in the order of the cameras, for equal bits
        sums += found
    return _Contributions(sums[:, 0], sums[:, 1])


def _project(points: Gaussians, camera: Camera, near: float) -> splat.Projection:
    view = camera.viewmat, camera.K, camera.width, camera.height
    return splat.project(points.means, points.quats, points.scales, *view, near)


def _vote(means: np.ndarray, weights: _Contributions, neighbors: int) -> np.ndarray:
    """Return the share [N] of each point's contribution that lies in the masks, averaged with its nearest seen neighbors."""
    seen = weights.seen
    votes = np.where(seen, weights.share, np.float32(0))
    count = min(neighbors, len(means) - 1)
    if count < 1:
        return votes
    index = splat.nearest_neighbors(means, count)[0]
    around = np.concatenate([np.arange(len(means))[:, None], index], 1)
    return votes[around].sum(1) / np.maximum(seen[around].sum(1, dtype=np.float32), 1)


def _minimize(
    points: Gaussians, cameras: list[Camera], masks: np.ndarray, near: float, config: LayeringConfig
) -> np.ndarray:
    """Return the labels [N] that minimize the paper's L_m, by one random view per iteration.

    The sums over points are divided by the number of views, since each iteration has only one view's share of the first term.
    """
    rng, count = np.random.default_rng(0), len(points)
    labels, ones = np.full(count, 0.5, np.float32), np.ones(1, np.float32)
    trained = adam.Trained(labels, np.zeros_like(labels), np.zeros_like(labels))
    nearest = splat.nearest_neighbors(points.means, 1)[0][:, 0] if count > 1 else np.zeros(1, np.int64)
    for iteration in range(ITERATIONS):
        view = int(rng.integers(len(cameras)))
        slopes = _slopes_of_drawing(points, labels, cameras[view], masks[view], near)
        alike = np.sign(labels - labels[nearest])
        of_nearest = np.bincount(nearest, alike, count).astype(np.float32)
        moving = np.sign(labels - 1)
        slopes += (LAMBDA_NN * (alike - of_nearest) + LAMBDA_DYN * moving) / len(cameras)
        rate = LIFT_RATE * 0.1 ** (iteration / ITERATIONS)
        adam.adam([adam.Step(trained, slopes, ones, 0, count, (rate, 0.9, 0.999, 1e-8, iteration + 1))])
        np.clip(labels, 0, 1, out=labels)
    return labels


def _slopes_of_drawing(
    points: Gaussians, labels: np.ndarray, camera: Camera, mask: np.ndarray, near: float
) -> np.ndarray:
    """Return the gradient [N] of the L1 distance between drawn labels [N] and a mask [H, W] bool to the labels."""
    colors = np.repeat(labels[:, None], 3, 1)
    splats = _project(points, camera, near).colored(colors, points.opacities)
    bins = splat.bin(splats, camera.width, camera.height)
    drawn = rasterize.forward(bins, colors)[0][..., :1]
    return rasterize.gather(bins, np.sign(drawn - mask[..., None].astype(np.float32)))[:, 0]
