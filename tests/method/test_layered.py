"""Layer-aware drawing: iterations that draw only tiles with moving points have the same gradients as complete ones."""

import numpy as np
import pytest
import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.group_trainer import GroupTrainer
from splatreel.method.train.render import View, draw
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.static_points import StaticPoints
from tests.method.captures import blots
from tests.method.scenes import random_gaussians, ring
from tests.method.small import plain

CPU, NEAR, UNIT, FRAMES = torch.device("cpu"), 0.1, 4.0, 6
CAMERAS = ring(3, width=150, height=100)


def trainer(seed: int, speed: float) -> GroupTrainer:
    """A cluster that crosses the image in front of and through static points, and images of noise; nothing fits."""
    rng = np.random.default_rng(seed)
    thing = blots(40, [-1.2, -0.4, -0.6], [-0.7, 0.3, 0.2], 0.05, seed)
    static = random_gaussians(250, seed, sh_degree=0, spread=2.0)
    tracks = np.stack([thing.means + np.array([speed * t, 0, 0]) for t in range(FRAMES)]).astype(np.float32)
    images = torch.from_numpy(rng.integers(0, 256, (FRAMES, len(CAMERAS), 100, 150, 3), dtype=np.uint8))
    frames = TrainingImages(images, [View.of(camera, CPU) for camera in CAMERAS], NEAR, UNIT)
    gains = CameraGains(len(CAMERAS), CPU)
    gains.load(torch.from_numpy(rng.uniform(0.9, 1.1, (len(CAMERAS), 3)).astype(np.float32)))
    config = plain({"group.length": FRAMES, "group.overlap": 0, "group.iterations_per_frame": 10})
    static_points = StaticPoints(static, np.ones(len(static), bool))
    return GroupTrainer(frames, GroupStart(thing, tracks), static_points, config, gains=gains, seed=seed)


def gradients(group: GroupTrainer, frame: int, camera: int, layered: bool) -> tuple[float, list[Tensor], Tensor | None]:
    """The loss, its gradients to every parameter of the points and of their motion, and the tiles drawn."""
    assert isinstance(group.points.deformation, Trajectory)
    group.points.deformation.evaluations.clear()
    group.points.canonical.clear()
    view, target = group.images.views[camera], group.images.pixels[frame, camera]
    drawing = draw(group.points.at(frame, view, NEAR), view, group.static.view(camera), layered=layered)
    gain = group.gains.values.detach()[camera]
    loss = splat.photometric_loss(drawing.image, target, 0.2, gain, drawing.tiles)
    loss.backward()
    seen = group.points.deformation.evaluations[0]
    leaves = [*group.points.canonical.params.values(), seen.dx, seen.dq]
    found = [leaf.grad.clone() for leaf in leaves if leaf.grad is not None]
    assert len(found) == len(leaves)
    return loss.item(), found, drawing.tiles


def assert_same_gradients(group: GroupTrainer) -> list[float]:
    """In every camera at some frames; returns the shares of tiles that were drawn."""
    shares = []
    for frame in (0, 2, FRAMES - 1):
        for camera in range(len(CAMERAS)):
            _, expected, everything = gradients(group, frame, camera, layered=False)
            _, found, tiles = gradients(group, frame, camera, layered=True)
            assert everything is None
            assert tiles is not None
            shares.append(float(tiles.float().mean()))
            for a, b in zip(found, expected, strict=True):
                torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-5 * float(b.norm()))
    return shares


@pytest.mark.parametrize("seed", range(3))
def test_gradients_are_those_of_the_whole_image(seed: int) -> None:
    """Also after points were converted, cloned and pruned, and where they leave the image."""
    group = trainer(seed, speed=0.7)
    shares = assert_same_gradients(group)
    assert 0 < np.mean(shares) < 0.6
    assert min(shares) < 0.5 * max(shares), "some leave the image"
    for change in (
        lambda: group.density.convert(torch.arange(0, 250, 9)),
        lambda: group.points.clone(torch.arange(0, 40, 3)),
        lambda: group.points.keep(torch.arange(1, len(group.points), 2)),
    ):
        before = len(group.points)
        change()
        assert len(group.points) != before
        group.density.restart()
        group.find_neighbors()
        group.step(0)
        shares = assert_same_gradients(group)
        assert 0 < np.mean(shares) < 1


def test_loss_changes_as_that_of_the_whole_image() -> None:
    """The two differ by what nothing that moves can change."""
    group = trainer(0, speed=0.1)
    apart = []
    for shift in (0.0, 0.01, 0.02):
        with torch.no_grad():
            group.points.means[:, 1] += shift
        whole, _, _ = gradients(group, 2, 1, layered=False)
        part, _, tiles = gradients(group, 2, 1, layered=True)
        assert tiles is not None
        apart.append((whole, whole - part, tiles))
    assert len({loss for loss, _, _ in apart}) == 3
    for _, difference, tiles in apart[1:]:
        if torch.equal(tiles, apart[0][2]):
            assert difference == pytest.approx(apart[0][1], abs=1e-6)
    assert any(torch.equal(tiles, apart[0][2]) for _, _, tiles in apart[1:])
