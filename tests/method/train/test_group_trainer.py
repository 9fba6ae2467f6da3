"""Training of groups of a tiny rendered scene: a cluster passes in front of a wall."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.config import Config
from splatreel.config.settings import changed
from splatreel.kernels.image import render_image
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.deform.hashgrid import HashGrid
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train import density
from splatreel.method.train.group_trainer import FrameSchedule, GroupResult, GroupTrainer
from splatreel.method.train.render import View
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group
from tests.method.captures import blots
from tests.method.scenes import ring
from tests.method.small import plain

CAMERAS = ring(4, width=48, height=32)
FRAMES, NEAR, UNIT = 5, 0.1, 4.0
SPEED = 0.06
WALL = blots(400, [-3, -2, 0.9], [3, 2, 1.0], 0.14, 0)
THING = blots(48, [-0.8, -0.6, -0.4], [0.2, 0.6, 0.2], 0.14, 1)


def moved(points: Gaussians, frame: float) -> Gaussians:
    means = points.means + np.array([SPEED * frame, 0, 0])
    return Gaussians(means, points.quats, points.scales, points.opacities, points.sh)


def frames(thing: Gaussians = THING, count: int = FRAMES) -> TrainingImages:
    scenes = [Gaussians.concatenate([WALL, moved(thing, t)]) for t in range(count)]
    images = [[render_image(scene, camera, near=NEAR) for camera in CAMERAS] for scene in scenes]
    pixels = (np.clip(images, 0, 1) * 255).round().astype(np.uint8)
    return TrainingImages(pixels, [View.of(camera) for camera in CAMERAS], NEAR, UNIT)


@pytest.fixture(scope="module")
def filmed() -> TrainingImages:
    return frames()


def config(deformation="trajectory", iterations=30, **layering) -> Config:
    group = {"length": FRAMES, "overlap": 0, "deformation": deformation, "iterations_per_frame": iterations}
    layering = {"adapt_every": 0, **layering}
    return plain(
        {f"group.{name}": value for name, value in group.items()}
        | {f"layering.{name}": value for name, value in layering.items()}
    )


def trainer(
    filmed: TrainingImages,
    config: Config,
    dynamic: Gaussians = THING,
    static: Gaussians = WALL,
    tracks=None,
    may_move=None,
):
    gains = CameraGains(len(CAMERAS), enabled=False)
    static_points = StaticPoints(static, np.ones(len(static), bool))
    return GroupTrainer(filmed, GroupStart(dynamic, tracks), static_points, config, gains=gains, may_move=may_move)


def with_group(config: Config, **changes) -> Config:
    return replace(config, group=replace(config.group, **changes))


class Losses(Silent):
    def __init__(self) -> None:
        self.values: list[float] = []

    def update(self, done: int, **numbers: float) -> None:
        if "loss" in numbers:
            self.values.append(numbers["loss"])


def quality(filmed: TrainingImages, result: GroupResult, static: Gaussians = WALL) -> float:
    """Return the PSNR over all frames and cameras, drawn as by a viewer."""
    squares = []
    group = Group(0, 0, result.dynamic, result.dx, result.dq, result.alive, result.shade)
    for frame, images in enumerate(filmed.pixels):
        scene = Gaussians.concatenate([static[result.alive], group.at(frame)])
        squares += [
            np.square(np.clip(render_image(scene, camera, near=NEAR), 0, 1) - image / 255).mean()
            for camera, image in zip(CAMERAS, images, strict=True)
        ]
    return float(-10 * np.log10(np.mean(squares)))


@pytest.mark.parametrize(
    ("deformation", "least"), [("trajectory", 28), pytest.param("hashgrid", 30, marks=pytest.mark.slow)]
)
def test_group_learns_motion(filmed: TrainingImages, deformation: str, least: float) -> None:
    group, losses = trainer(filmed, config(deformation, 60)), Losses()
    assert isinstance(group.points.deformation, HashGrid if deformation == "hashgrid" else Trajectory)
    assert quality(filmed, group.result()) < 27, "standing still is not good enough"
    result = group.train(losses)
    assert quality(filmed, result) > least
    assert len(losses.values) == 60 * FRAMES // 50
    assert np.isfinite(losses.values).all()
    assert result.dx.shape == (FRAMES, len(result.dynamic), 3)
    assert result.dq.shape == (FRAMES, len(result.dynamic), 4)
    assert result.alive.all()


def test_group_learns_darkening_and_fading() -> None:
    """The object rests; one half darkens, the other half vanishes."""
    scenes = []
    for t in range(FRAMES):
        share, half = t / (FRAMES - 1), np.arange(len(THING)) % 2
        shade = np.stack([-0.8 * share * half] * 3 + [-share * (1 - half) * THING.opacities], 1)
        scenes.append(Gaussians.concatenate([WALL, THING.shaded(shade.astype(np.float32))]))
    images = [[render_image(scene, camera, near=NEAR) for camera in CAMERAS] for scene in scenes]
    pixels = (np.clip(images, 0, 1) * 255).round().astype(np.uint8)
    dark = TrainingImages(pixels, [View.of(camera) for camera in CAMERAS], NEAR, UNIT)
    whole = config(iterations=60)
    with_shade = with_group(whole, appearance=True)
    without, found = (trainer(dark, c).train(Silent()) for c in (whole, with_shade))
    assert without.shade is None
    assert found.shade is not None
    assert found.shade.shape == (FRAMES, len(found.dynamic), 4)
    assert (found.dynamic.opacities + found.shade[..., 3] >= 0).all()
    assert quality(dark, found) > quality(dark, without) + 3


def test_group_training_starts_with_small_images(filmed: TrainingImages, monkeypatch: pytest.MonkeyPatch) -> None:
    group = trainer(filmed, with_group(config(iterations=60), coarse_share=0.25))
    heights, plan = [], group.plan
    monkeypatch.setattr(group, "plan", lambda n: heights.append(group.images.pixels.shape[2]) or plan(n))
    result = group.train(Silent())
    assert heights == [16] * 75 + [32] * 225
    assert quality(filmed, result) > 28


@pytest.mark.parametrize("deformation", ["trajectory", "hashgrid"])
def test_group_starts_well_from_true_tracks(filmed: TrainingImages, deformation: str) -> None:
    tracks = np.stack([moved(THING, t).means for t in range(FRAMES)])
    group = trainer(filmed, config(deformation), tracks=tracks)
    assert quality(filmed, group.result()) > 35
    assert group.psnr() > 35


def test_lambda_sh_reduces_view_dependent_color(filmed: TrainingImages) -> None:
    """The object looks the same from everywhere, but starts with view-dependent color."""
    sheen = np.full((len(THING), 3, 3), 0.1, np.float32)
    sheeny = replace(THING, sh=np.concatenate([THING.sh, sheen], 1))

    def trained(price: float) -> GroupResult:
        return trainer(filmed, with_group(config(iterations=40), lambda_sh=price), sheeny).train(Silent())

    free, priced = trained(0.0), trained(1.0)
    assert np.abs(priced.dynamic.sh[:, 1:]).mean() < 0.9 * np.abs(free.dynamic.sh[:, 1:]).mean()
    assert quality(filmed, priced) > quality(filmed, free) - 0.5


def test_group_training_is_deterministic_per_seed(filmed: TrainingImages) -> None:
    a, b = (trainer(filmed, config(iterations=6)).train(Silent()) for _ in range(2))
    np.testing.assert_array_equal(a.dx, b.dx)
    np.testing.assert_array_equal(a.dynamic.means, b.dynamic.means)


def test_conversion_makes_moving_static_points_dynamic(filmed: TrainingImages, monkeypatch: pytest.MonkeyPatch) -> None:
    """A few moving points start as static ones. They are converted, and no point of the wall is."""
    monkeypatch.setattr(density, "ADAPT_NEIGHBORS", 0.4)
    few = np.arange(len(THING)) % 8 == 0
    static = Gaussians.concatenate([WALL, THING[few]])
    group = trainer(filmed, config(iterations=60, adapt_every=30), THING[~few], static)
    result = group.train(Silent())
    converted = ~result.alive
    assert converted[len(WALL) :].mean() > 0.7
    assert converted[: len(WALL)].mean() < 0.1
    assert len(result.dynamic) >= (~few).sum() + converted[len(WALL) :].sum() - 5
    assert result.dx.shape[1] == len(result.dynamic)


def test_conversion_by_gradient_alone(filmed: TrainingImages, monkeypatch: pytest.MonkeyPatch) -> None:
    few = np.arange(len(THING)) % 8 == 0
    static = Gaussians.concatenate([WALL, THING[few]])
    settings = config(iterations=40, adapt_every=40)
    monkeypatch.setattr(density, "ADAPT_NEIGHBORS", 2.0)
    monkeypatch.setattr(density, "ADAPT_GRADIENT", 1e9)
    strict = trainer(filmed, settings, THING[~few], static)
    assert strict.train(Silent()).alive.all(), "nothing is converted, nor by its neighbors"
    monkeypatch.setattr(density, "ADAPT_GRADIENT", 3e-4)
    loose = trainer(filmed, settings, THING[~few], static)
    alive = loose.train(Silent()).alive
    assert (~alive[len(WALL) :]).mean() > 0.3
    assert (~alive[: len(WALL)]).mean() < 0.05, "the wall stands still"


@pytest.fixture
def all_convert(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any gradient converts a static point."""
    monkeypatch.setattr(density, "ADAPT_GRADIENT", 0.0)
    monkeypatch.setattr(density, "ADAPT_NEIGHBORS", 2.0)


@pytest.mark.usefixtures("all_convert")
def test_conversion_respects_may_move(filmed: TrainingImages) -> None:
    settings = config(iterations=8, adapt_every=10)
    may = np.arange(len(WALL)) % 2 == 0
    alive = trainer(filmed, settings, may_move=may).train(Silent()).alive
    assert alive[~may].all()
    assert not alive[may].all()


@pytest.mark.usefixtures("all_convert")
def test_conversion_and_cloning_stop_at_budget(filmed: TrainingImages) -> None:
    group = trainer(filmed, config(iterations=8, adapt_every=10))
    group.density.budget = 50
    before = len(group.points)
    result = group.train(Silent())
    assert before < len(result.dynamic) <= before + 50
    assert group.density.budget == 0
    assert len(result.dynamic) >= before + (~result.alive).sum() - 5


@pytest.mark.parametrize("deformation", ["trajectory", "hashgrid"])
def test_prune_keeps_points_and_motion_aligned(filmed: TrainingImages, deformation: str) -> None:
    """Every third point fades; the others keep position and motion."""
    tracks = np.stack([moved(THING, t).means for t in range(FRAMES)])
    tracks[..., 1] += np.linspace(0, 0.1, FRAMES)[:, None] * np.arange(len(THING))  # every point has another motion
    group = trainer(filmed, config(deformation), tracks=tracks)
    before = group.result()
    faint = np.arange(len(THING)) % 3 == 0
    group.points.canonical.params["logit_opacities"][faint] = -8
    group.density.prune(group.images)
    after, kept = group.result(), ~faint
    np.testing.assert_array_equal(after.dynamic.means, before.dynamic.means[kept])
    np.testing.assert_allclose(after.dx, before.dx[:, kept], atol=1e-6)
    group.density.restart()
    group.find_neighbors()
    group.step(0)  # the optimizers match the rows


def test_prune_keeps_large_far_points(filmed: TrainingImages) -> None:
    """Pruning a far wall that became dynamic, because of a shadow, would leave a hole."""
    wide = 0.8 * filmed.unit
    two = replace(THING[:2], means=np.array([[0, 0, 0], [0, 0, 4 * filmed.unit]], np.float32))
    two = replace(two, scales=np.full((2, 3), wide, np.float32), opacities=np.full(2, 0.9, np.float32))
    group = trainer(filmed, changed(config(), {"keyframe.far_step_scale": 8.0}), two)
    group.density.prune(group.images)
    np.testing.assert_allclose(group.points.means[:, 2], [4 * filmed.unit], atol=1e-5)


def test_prune_never_removes_all_points(filmed: TrainingImages) -> None:
    group = trainer(filmed, config(), THING.faded(0.001))
    group.density.prune(group.images)
    assert len(group.points) == len(THING)
    group = trainer(filmed, config(), moved(THING, 1e4))
    group.density.drop_faint(group.images)
    assert len(group.points) == len(THING), "out of sight"


def test_drop_faint_removes_invisible_points(filmed: TrainingImages) -> None:
    """Some points lie behind the wall, where no camera sees them."""
    hidden = blots(30, [-0.8, -0.6, 1.3], [0.2, 0.6, 1.5], 0.05, 2)
    tracks = np.stack([moved(Gaussians.concatenate([THING, hidden]), t).means for t in range(FRAMES)])
    settings = with_group(config(), faint_share=0.01)
    wall = Gaussians(WALL.means, WALL.quats, WALL.scales, np.full(len(WALL), 0.999), WALL.sh)
    group = trainer(filmed, settings, Gaussians.concatenate([THING, hidden]), wall, tracks)
    assert quality(filmed, group.result(), wall) > 38
    group.density.drop_faint(group.images)
    result = group.result()
    assert len(result.dynamic) < len(THING) + 0.5 * len(hidden)
    assert (result.dynamic.means[:, 2] < 1).sum() > 0.8 * len(THING)
    assert quality(filmed, result, wall) > 38


@pytest.mark.parametrize("deformation", ["trajectory", "hashgrid"])
def test_group_without_motion(filmed: TrainingImages, deformation: str) -> None:
    notes = Losses()
    result = trainer(filmed, config(deformation), Gaussians.empty(0)).train(notes)
    assert len(result.dynamic) == 0
    assert result.dx.shape == (FRAMES, 0, 3)
    assert result.dq.shape == (FRAMES, 0, 4)
    assert result.alive.all()
    assert not notes.values


def test_group_with_one_dynamic_and_no_static_point() -> None:
    filmed = frames(THING[:1], 2)
    settings = config(iterations=4, adapt_every=2)
    result = trainer(filmed, settings, THING[:1], Gaussians.empty(0)).train(Silent())
    assert len(result.dynamic) >= 1
    assert np.isfinite(result.dx).all()


def test_group_applies_gains_without_changing_them(filmed: TrainingImages) -> None:
    """A camera that records at half brightness does not change the scene."""
    dim = replace(
        filmed, pixels=np.rint(filmed.pixels * np.array([1, 1, 0.5, 1])[:, None, None, None]).astype(np.uint8)
    )
    gains = CameraGains(len(CAMERAS))
    gains.load(np.array([[1.0] * 3, [1.0] * 3, [0.5] * 3, [1.0] * 3], np.float32))
    kept = gains.values.copy()
    wall = StaticPoints(WALL, np.ones(len(WALL), bool))
    tracks = np.stack([moved(THING, t).means for t in range(FRAMES)])
    group = GroupTrainer(dim, GroupStart(THING, tracks), wall, config(iterations=2), gains=gains)
    assert group.psnr() > 35
    group.train(Silent())
    np.testing.assert_array_equal(gains.values, kept)


def test_frontier_moves_from_first_to_last_frame():
    schedule = FrameSchedule(np.ones((10, 3), bool), iterations=1000, progressive=0.5, seed=0)
    assert [schedule.frontier(i) for i in (0, 49, 50, 250, 499, 500, 999)] == [0, 0, 1, 5, 9, 9, 9]
    for i in range(0, 500, 7):
        frame, camera = schedule.draw(i)
        assert frame <= schedule.frontier(i)
        assert 0 <= camera < 3


def test_warm_up_prefers_newest_frames():
    schedule = FrameSchedule(np.ones((10, 3), bool), iterations=1000, progressive=0.5, seed=0)
    drawn = [schedule.draw(250) for _ in range(600)]  # the frontier is frame 5
    assert set(drawn) == {(frame, camera) for frame in range(6) for camera in range(3)}
    newest = np.mean([frame > 5 - FrameSchedule.FRONTIER_FRAMES for frame, _ in drawn])
    share = FrameSchedule.FRONTIER_SHARE
    assert newest == pytest.approx(share + (1 - share) / 2, abs=0.06)


@pytest.mark.parametrize("progressive", [0.0, 0.5])
def test_round_contains_every_image_once(progressive):
    schedule = FrameSchedule(np.ones((5, 4), bool), iterations=100, progressive=progressive, seed=1)
    for _ in range(3):
        assert sorted(schedule.draw(99) for _ in range(20)) == [(f, c) for f in range(5) for c in range(4)]
    orders = [[schedule.draw(99) for _ in range(20)] for _ in range(2)]
    assert orders[0] != orders[1]


def test_frame_with_larger_loss_is_drawn_more_often():
    schedule = FrameSchedule(np.ones((6, 8), bool), iterations=100, progressive=0.0, seed=0)
    for frame in range(6):
        for camera in range(8):  # some cameras have larger errors in every frame
            schedule.record_loss(frame, camera, (2.0 if frame == 4 else 1.0) * (1 + camera))
    wanted = schedule.draws_per_round()
    assert wanted.mean() == pytest.approx(1)
    assert wanted[4] == pytest.approx(2 * wanted[0])
    np.testing.assert_allclose(wanted[[0, 1, 2, 3, 5]], wanted[0])
    drawn = np.bincount([schedule.draw(99)[0] for _ in range(48 * 40)], minlength=6)
    assert drawn[4] == pytest.approx(2 * drawn[[0, 1, 2, 3, 5]].mean(), rel=0.1)


def test_draws_per_round_are_limited():
    schedule = FrameSchedule(np.ones((4, 1), bool), iterations=10, progressive=0.0, seed=0)
    for frame, loss in enumerate((1e-9, 1.0, 1.0, 1e3)):
        schedule.record_loss(frame, 0, loss)
    wanted = schedule.draws_per_round()
    assert wanted.max() / wanted.min() <= 6
    assert {schedule.draw(0)[0] for _ in range(60)} == {0, 1, 2, 3}


def test_frames_without_loss_have_mean_draws():
    schedule = FrameSchedule(np.ones((3, 2), bool), iterations=10, progressive=0.0, seed=0)
    schedule.record_loss(0, 0, 0.5)
    np.testing.assert_allclose(schedule.draws_per_round(), 1)


@pytest.mark.parametrize("progressive", [0.0, 0.5])
def test_missing_images_are_never_drawn(progressive):
    available = np.ones((4, 3), bool)
    available[0, 1] = available[2, :2] = False
    schedule = FrameSchedule(available, iterations=200, progressive=progressive, seed=0)
    drawn = {schedule.draw(iteration) for iteration in range(200)}
    assert drawn == {(frame, camera) for frame, camera in np.argwhere(available).tolist()}
