"""Lifting of masks to labels of points."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.base.errors import ReconstructionError
from splatreel.config import LayeringConfig
from splatreel.kernels.image import render_image
from splatreel.method.layering import lift as lifting
from splatreel.method.layering.labels import DYNAMIC_LABEL
from splatreel.method.layering.lift import lift, shares
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians

VOTE = LayeringConfig(lift="vote")
OPTIMISE = LayeringConfig(lift="optimize")
NEAR = 0.1


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lifting, "ITERATIONS", 120)


def cameras() -> list[Camera]:
    """Return three cameras side by side that look along +z at a wall at depth 4."""
    K = np.array([[60, 0, 32], [0, 60, 24], [0, 0, 1]])
    found = []
    for i, x in enumerate((-0.5, 0.0, 0.5)):
        viewmat = np.eye(4)
        viewmat[0, 3] = -x
        found.append(Camera(f"cam{i}", viewmat, K, 64, 48))
    return found


def wall() -> Gaussians:
    """Return a wall of splats; the last point is behind the cameras."""
    x, y = np.meshgrid(np.linspace(-2, 2, 30), np.linspace(-1.5, 1.5, 22))
    means = np.stack([x.ravel(), y.ravel(), np.full(x.size, 4.0)], 1)
    means = np.concatenate([means, [[0, 0, -5.0]]])
    n = len(means)
    quats = np.tile([1.0, 0, 0, 0], (n, 1))
    return Gaussians(means, quats, np.full((n, 3), 0.08), np.full(n, 0.9), np.zeros((n, 1, 3)))


def right_masks() -> np.ndarray:
    """Return masks of the right part of the wall, from x = 0.5 on, for every camera."""
    masks = np.zeros((3, 48, 64), bool)
    for mask, camera in zip(masks, cameras(), strict=True):
        edge = (0.5 - camera.center[0]) / 4 * 60 + 32
        mask[:, round(edge) :] = True
    return masks


@pytest.mark.parametrize("config", [VOTE, OPTIMISE], ids=["vote", "optimize"])
def test_lift_labels_follow_masks(config: LayeringConfig) -> None:
    points = wall()
    moving = points.means[:, 0] > 0.5
    labels = lift(points, cameras(), right_masks(), NEAR, config)
    assert labels.dtype == np.float32
    assert labels.min() >= 0
    assert labels.max() <= 1
    visible = (np.abs(points.means[:, 0]) < 1.5) & (np.abs(points.means[:, 1]) < 1.2) & (points.means[:, 2] > 0)
    sure = visible & (np.abs(points.means[:, 0] - 0.5) > 0.3)
    assert ((labels > DYNAMIC_LABEL) == moving)[sure].mean() > 0.98


@pytest.mark.parametrize("config", [VOTE, OPTIMISE], ids=["vote", "optimize"])
def test_nothing_moves_and_everything_moves(config: LayeringConfig) -> None:
    points = wall()
    nothing = lift(points, cameras(), np.zeros((3, 48, 64), bool), NEAR, config)
    assert nothing.shape == (len(points),)
    assert (nothing == 0).all()
    everything = lift(points, cameras(), np.ones((3, 48, 64), bool), NEAR, config)
    seen = (np.abs(points.means[:, 0]) < 1.5) & (np.abs(points.means[:, 1]) < 1.2) & (points.means[:, 2] > 0)
    assert (everything[seen] > DYNAMIC_LABEL).all()
    assert everything[-1] == 0, "a point that no camera sees is static"


def test_lift_hidden_point_stays_static(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lifting, "NEIGHBORS", 0)
    """Votes are weighted by what reaches the pixel: a moving wall in front says nothing about one far behind it."""
    front, points = wall(), wall()
    behind = Gaussians(
        points.means[:-1] * [1.6, 1.6, 2], points.quats[:-1], points.scales[:-1], points.opacities[:-1], points.sh[:-1]
    )
    left = front[(front.means[:, 0] < 0.2) & (front.means[:, 2] > 0)]
    masks = np.zeros((3, 48, 64), bool)
    for mask, camera in zip(masks, cameras(), strict=True):
        mask[:, : round((0.25 - camera.center[0]) / 4 * 60 + 32)] = True
    labels = lift(Gaussians.concatenate([left, behind]), cameras(), masks, NEAR, VOTE)
    far_right = behind.means[:, 0] > 1.5
    assert (labels[len(left) :][far_right] < 0.1).all()
    seen = (np.abs(left.means[:, 0]) < 1.2) & (np.abs(left.means[:, 1]) < 1)
    assert (labels[: len(left)][seen] > 0.8).all()


def test_lift_one_point_and_no_point() -> None:
    one = wall()[np.array([330])]
    assert lift(one, cameras(), np.ones((3, 48, 64), bool), NEAR, VOTE)[0] > 0.99
    assert lift(one, cameras(), np.ones((3, 48, 64), bool), NEAR, OPTIMISE)[0] > 0.9
    assert lift(Gaussians.empty(), cameras(), np.ones((3, 48, 64), bool), NEAR, VOTE).shape == (0,)


def test_gradient_of_lifting_is_that_of_the_drawn_error() -> None:
    """The error is linear in the labels as long as no pixel's error changes its sign."""
    points, camera, mask = wall(), cameras()[1], right_masks()[1]
    labels = np.random.default_rng(0).uniform(0.2, 0.8, len(points)).astype(np.float32)

    def error(changed: np.ndarray) -> float:
        colored = replace(points, sh=np.repeat((changed[:, None, None] - 0.5) / C0, 3, 2))
        return float(np.abs(render_image(colored, camera, near=NEAR)[..., 0].astype(np.float64) - mask).sum())

    slopes = lifting._slopes_of_drawing(points, labels, camera, mask, NEAR)
    for row in (31, 330, 345, 400, len(points) - 1):
        ends = [error(labels + way * (np.arange(len(points)) == row)) for way in (-0.01, 0.01)]
        assert slopes[row] == pytest.approx((ends[1] - ends[0]) / 0.02, abs=0.01)
    assert np.abs(slopes).max() > 1
    assert slopes[-1] == 0


def test_lift_refuses_masks_of_other_size() -> None:
    with pytest.raises(ReconstructionError, match=r"\(3, 24, 32\)"):
        lift(wall(), cameras(), np.ones((3, 24, 32), bool), NEAR, VOTE)


def test_shares_are_nan_for_unseen_points() -> None:
    points = wall()
    found, x = shares(points, cameras(), right_masks(), NEAR), points.means[:-1, 0]
    assert np.isnan(found[-1]), "it is behind all cameras"
    assert found[:-1][x > 0.7].min() > 0.9
    assert found[:-1][x < 0.3].max() < 0.1
    assert shares(Gaussians.empty(), cameras(), right_masks(), NEAR).shape == (0,)
