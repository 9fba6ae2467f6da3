"""Layer-aware drawing: iterations that draw only tiles with moving points have the same gradients as complete ones."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.kernels import splat
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.cpu_program import CpuGroupProgram
from splatreel.method.train.group_trainer import GroupTrainer
from splatreel.method.train.losses import GROUP
from splatreel.method.train.programs import Draw
from splatreel.method.train.render import View
from splatreel.method.train.terms.custom import Custom
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import StaticPoints
from tests.method.captures import blots
from tests.method.scenes import random_gaussians, ring
from tests.method.small import plain

NEAR, UNIT, FRAMES = 0.1, 4.0, 6
CAMERAS = ring(3, width=150, height=100)
NOTHING = Custom("nothing", function=lambda seen: (0.0, {}))
"""A term that has the whole image drawn."""


def trainer(seed: int, speed: float) -> GroupTrainer:
    """A cluster that crosses the image in front of and through static points, and images of noise; nothing fits."""
    rng = np.random.default_rng(seed)
    thing = blots(40, [-1.2, -0.4, -0.6], [-0.7, 0.3, 0.2], 0.05, seed)
    static = random_gaussians(250, seed, sh_degree=0, spread=2.0)
    tracks = np.stack([thing.means + np.array([speed * t, 0, 0]) for t in range(FRAMES)]).astype(np.float32)
    images = rng.integers(0, 256, (FRAMES, len(CAMERAS), 100, 150, 3), dtype=np.uint8)
    frames = TrainingImages(images, [View.of(camera) for camera in CAMERAS], NEAR, UNIT)
    gains = CameraGains(len(CAMERAS))
    gains.load(rng.uniform(0.9, 1.1, (len(CAMERAS), 3)).astype(np.float32))
    config = plain({"group.length": FRAMES, "group.overlap": 0, "group.iterations_per_frame": 10})
    static_points = StaticPoints(static, np.ones(len(static), bool))
    return GroupTrainer(frames, GroupStart(thing, tracks), static_points, config, gains=gains, seed=seed)


def gradients(group: GroupTrainer, draw: Draw) -> tuple[float, dict[str, np.ndarray]]:
    """Return the loss of a draw, and its gradients to the points."""
    program = group.program
    assert isinstance(program, CpuGroupProgram)
    found = program.gradients(draw, program.prepare(draw))
    return found.outcome.loss, found.points


def drawn_tiles(group: GroupTrainer, draw: Draw) -> np.ndarray:
    """Return the tiles that moving points touch."""
    view = group.images.views[draw.camera]
    bins = splat.bin(group.points.at(draw.moment, view, NEAR), view.width, view.height)
    return bins.counts > 0


def assert_same_gradients(group: GroupTrainer) -> list[float]:
    """Compare in every camera at some frames. Return the shares of tiles that were drawn."""
    shares = []
    for frame in (0, 2, FRAMES - 1):
        for camera in range(len(CAMERAS)):
            group.losses = GROUP
            group.start_program(Silent())
            draw = replace(group.plan(0), frame=frame, last=FRAMES - 1, camera=camera, moment=frame, whole=False)
            draw = replace(draw, metered_static=False, rank=None, span=None)
            loss, found = gradients(group, draw)
            _, together = gradients(group, replace(draw, metered_static=True))
            group.losses = [*GROUP, NOTHING]
            group.start_program(Silent())
            same, complete = gradients(group, draw)
            assert loss == pytest.approx(same, rel=1e-5)
            for name, gradient in complete.items():
                for other in (found, together):
                    tolerance = 1e-5 * float(np.linalg.norm(gradient))
                    np.testing.assert_allclose(other[name], gradient, rtol=1e-3, atol=tolerance, err_msg=name)
            shares.append(float(drawn_tiles(group, draw).mean()))
    return shares


@pytest.mark.parametrize("seed", range(3))
def test_gradients_are_those_of_the_whole_image(seed: int) -> None:
    """Also after points were converted, cloned and pruned, and where they leave the image."""
    group = trainer(seed, speed=0.7)
    shares = assert_same_gradients(group)
    assert 0 < np.mean(shares) < 0.6
    assert min(shares) < 0.5 * max(shares), "some leave the image"
    changes: tuple[Callable[[], None], ...] = (
        lambda: group.density.convert(np.arange(0, 250, 9)),
        lambda: group.points.clone(np.arange(0, 40, 3)),
        lambda: group.points.keep(np.arange(1, len(group.points), 2)),
    )
    for change in changes:
        before = len(group.points)
        change()
        assert len(group.points) != before
        group.density.restart()
        group.find_neighbors()
        group.start_program(Silent())
        group.step(0)
        shares = assert_same_gradients(group)
        assert 0 < np.mean(shares) < 1


def test_loss_changes_as_that_of_the_whole_image() -> None:
    """The two differ by what nothing that moves can change."""
    group = trainer(0, speed=0.1)
    group.start_program(Silent())
    draw = replace(group.plan(1), frame=2, last=FRAMES - 1, camera=1, moment=2, metered_static=False)
    apart = []
    for shift in (0.0, 0.01, 0.02):
        group.points.means[:, 1] += shift
        whole, part = (gradients(group, replace(draw, whole=on))[0] for on in (True, False))
        apart.append((whole, whole - part, drawn_tiles(group, draw)))
    assert len({loss for loss, _, _ in apart}) == 3
    for _, difference, tiles in apart[1:]:
        if np.array_equal(tiles, apart[0][2]):
            assert difference == pytest.approx(apart[0][1], abs=1e-6)
    assert any(np.array_equal(tiles, apart[0][2]) for _, _, tiles in apart[1:])
