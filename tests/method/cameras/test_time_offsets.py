"""Time offsets in a scene like that of `test_group_trainer` whose cameras are out of step."""

from typing import Literal

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.kernels.image import render_image
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.cameras.time_offsets import CERTAIN, MOST_FRAMES, TimeOffsets, neighborhood, slope
from splatreel.method.deform.hashgrid import HashGrid
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.group_trainer import GroupTrainer
from splatreel.method.train.render import View
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import Gaussians, StaticPoints
from tests.method.captures import blots
from tests.method.scenes import ring
from tests.method.small import plain

CAMERAS = ring(4, width=48, height=32)
FRAMES, NEAR, UNIT, SPEED = 6, 0.1, 4.0, 0.12
LATE = np.array([0.4, -0.3, 0.2, -0.3])
Model = Literal["trajectory", "hashgrid"]
WALL = blots(400, [-3, -2, 0.9], [3, 2, 1.0], 0.14, 0)
THING = blots(48, [-0.8, -0.6, -0.4], [0.2, 0.6, 0.2], 0.14, 1)


def moved(time: float) -> Gaussians:
    means = THING.means + np.array([SPEED * time, 0, 0])
    return Gaussians(means, THING.quats, THING.scales, THING.opacities, THING.sh)


def trained(
    late: np.ndarray, enabled: bool = True, deformation: Model = "trajectory"
) -> tuple[GroupTrainer, TimeOffsets]:
    """Train a group from tracks that ignore the time offsets."""
    images = np.empty((FRAMES, len(CAMERAS), 32, 48, 3), np.uint8)
    for t in range(FRAMES):
        for c, camera in enumerate(CAMERAS):
            scene = Gaussians.concatenate([WALL, moved(t + late[c])])
            images[t, c] = (np.clip(render_image(scene, camera, near=NEAR), 0, 1) * 255).round()
    views = [View.of(camera) for camera in CAMERAS]
    tracks = np.stack([moved(t).means for t in range(FRAMES)]).astype(np.float32)
    group = {"length": FRAMES, "overlap": 0, "iterations_per_frame": 60, "deformation": deformation}
    config = plain({"layering.adapt_every": 0, **{f"group.{name}": value for name, value in group.items()}})
    gains, delays = CameraGains(len(CAMERAS), enabled=False), TimeOffsets(len(CAMERAS), enabled)
    trainer = GroupTrainer(
        TrainingImages(images, views, NEAR, UNIT),
        GroupStart(THING, tracks),
        StaticPoints(WALL, np.ones(len(WALL), bool)),
        config,
        gains=gains,
        time_offsets=delays,
    )
    trainer.train(Silent())
    return trainer, delays


def test_time_offsets_are_learned_and_improve_images() -> None:
    trainer, delays = trained(LATE)
    assert np.abs(delays.values - LATE).max() < 0.15
    unaware, _ = trained(LATE, enabled=False)
    assert trainer.psnr() > unaware.psnr() + 1


def test_time_that_sound_takes_is_learned() -> None:
    """Videos of 60 frames a second were aligned by a sound 2, 4, 6 and 9 m away, which takes up to 1.6 frames."""
    meters = np.array([2.0, 9.0, 4.0, 6.0])
    late = 60 * (meters - meters.mean()) / 343
    _, delays = trained(late)
    assert np.ptp(late) > 1.2
    assert np.abs(delays.values - late).max() < 0.15


@pytest.mark.slow
def test_hash_grid_learns_time_offsets() -> None:
    _, delays = trained(LATE, deformation="hashgrid")
    assert np.abs(delays.values - LATE).max() < 0.2


def test_cameras_in_step_stay_in_step() -> None:
    _, delays = trained(np.zeros(4))
    assert np.abs(delays.values).max() < 0.05


def told(late: float, curvature: float, seed: int, cameras: int = 8, rounds: int = 130) -> bool:
    """Return whether an offset above a tenth of a frame is reported, for noisy slopes."""
    rng, delays = np.random.default_rng(seed), TimeOffsets(cameras)
    true = np.zeros(cameras)
    true[0] = late
    true -= true.mean()
    for number in range(rounds):
        for camera in range(cameras):
            slope = curvature * (delays.values[camera] - true[camera]) + rng.normal()
            delays.note(camera, slope, number / rounds)
    off = delays.learned().uncertainty([delays.values])
    return bool((np.abs(delays.values) > np.maximum(CERTAIN * off, 0.1)).any())


def test_undetermined_offsets_are_not_reported() -> None:
    """Noise alone carries delays as far, a tenth of a frame and more, each time another way."""
    assert sum(told(0.0, 0.0, seed) for seed in range(40)) <= 4
    assert sum(told(0.5, 30.0, seed) for seed in range(40)) >= 38


def test_disabled_offsets_are_zero() -> None:
    delays = TimeOffsets(3, enabled=False)
    assert [delays.moment(frame, 1, 5) for frame in range(5)] == [0, 1, 2, 3, 4]


def test_moments_stay_in_the_group_and_the_mean_is_zero() -> None:
    delays = TimeOffsets(3)
    for _ in range(400):
        delays.note(0, -1.0, 0.0)
    assert delays.values[0] == pytest.approx(MOST_FRAMES)
    assert delays.moment(4, 0, 5) == 4
    assert delays.moment(0, 1, 5) == 0
    assert delays.moment(2, 0, 5) == pytest.approx(2 + MOST_FRAMES)


@pytest.mark.parametrize("model", [Trajectory, HashGrid])
@pytest.mark.parametrize("moment", [0.0, 1.3, 2.5, 5.0])
def test_slope_is_that_of_the_loss(model: type[Trajectory | HashGrid], moment: float) -> None:
    """The slope is the exact difference of a loss that is linear in the offsets, also across knots and at both ends."""
    means, rng = THING.means, np.random.default_rng(1)
    deformation = model(means, FRAMES, UNIT)
    if isinstance(deformation, Trajectory):
        for level in deformation.controls:
            level[:] = rng.normal(0, 0.1, level.shape)
    factors = rng.standard_normal((len(means), 3), np.float32), rng.standard_normal((len(means), 4), np.float32)

    def loss(time: float) -> float:
        return sum(float((one * by).sum()) for one, by in zip(deformation.offsets(means, time), factors, strict=True))

    before, after = neighborhood(moment, FRAMES)
    assert (before, after) == (max(moment - 0.5, 0.0), min(moment + 0.5, FRAMES - 1.0))
    expected = (loss(after) - loss(before)) / (after - before)
    found = slope(deformation, means, moment, FRAMES, deformation.gradient(means, [(1.0, moment)], *factors))
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-4)
