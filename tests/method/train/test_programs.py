"""Whole iterations of programs, on a (software) GPU and on the CPU, against those of torch."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from splatreel.base import threads
from splatreel.base.errors import GaussiansError
from splatreel.base.progress import Silent
from splatreel.config import Config, preset
from splatreel.config.settings import changed
from splatreel.gpu.device import Gpu
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.kernels.image import render_image
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.cameras.time_offsets import TimeOffsets
from splatreel.method.deform.knot_adam import Adam
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train import gpu_program
from splatreel.method.train.average import Average
from splatreel.method.train.cpu_keyframe import CpuKeyframeProgram
from splatreel.method.train.gpu_group import GpuGroupProgram
from splatreel.method.train.group_trainer import GroupTrainer
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.losses import CHAPTER_KEYFRAME, KEYFRAME
from splatreel.method.train.opposite_backgrounds import with_opposite
from splatreel.method.train.render import View
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.static_points import StaticPoints
from tests.gpu.devices import DEVICES, REAL, OpenedGpu
from tests.method.scenes import ring

CPU, NEAR, UNIT, FRAMES = torch.device("cpu"), 0.1, 4.0, 5
CAMERAS = ring(4, width=48, height=32)
CLOSE = 1e-4
"""Relative difference of gradients, summed over an iteration with its own rounding."""
SURFACES_CLOSE = 3e-3
"""The same with the losses of surfaces: variances are small differences of large numbers, signs of tiny bends are chance, and unknown
pixels repeat a drawing that is rounded to 8 bits."""


ON_CPU = pytest.param(None, id="CPU")
"""The program of the CPU, which a trainer without a GPU starts."""


class Notes(Silent):
    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


def scattered(count: int, low: list[float], high: list[float], seed: int, bands: int = 4) -> Gaussians:
    """Return oblong points with view-dependent colors."""
    rng = np.random.default_rng(seed)
    quats, sh = rng.normal(size=(count, 4)), rng.normal(0, 0.1, (count, bands, 3))
    sh[:, 0] = rng.uniform(-1, 1.5, (count, 3))
    return Gaussians(
        rng.uniform(low, high, (count, 3)),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        np.exp(rng.normal(-2.0, 0.4, (count, 3))),
        rng.uniform(0.3, 0.9, count),
        sh,
    )


WALL = scattered(300, [-3, -2, 0.9], [3, 2, 1.0], 0)
THING = scattered(70, [-0.8, -0.6, -0.4], [0.2, 0.6, 0.2], 1)


def moved(points: Gaussians, frame: float) -> Gaussians:
    return replace(points, means=(points.means + np.array([0.06 * frame, 0, 0])).astype(np.float32))


def make_images(count: int, antialias: bool = True, background: bool = True, unknown: bool = False) -> TrainingImages:
    scenes = [Gaussians.concatenate([WALL, moved(THING, frame)]) for frame in range(count)]
    images = [[render_image(scene, camera, near=NEAR) for camera in CAMERAS] for scene in scenes]
    pixels = torch.from_numpy((np.clip(images, 0, 1) * 255).round().astype(np.uint8))
    views = [View.of(camera, CPU, antialias) for camera in CAMERAS]
    if background:
        views = [replace(view, background=torch.tensor([0.2, 0.1, 0.3])) for view in views]
    mask = None
    if unknown:
        mask = torch.zeros(pixels.shape[:4], dtype=torch.bool)
        mask[..., 3:9, 5:30] = True
    return TrainingImages(pixels, views, NEAR, UNIT, mask)


def camera_gains(enabled: bool) -> CameraGains:
    gains = CameraGains(len(CAMERAS), CPU, enabled)
    gains.load(torch.tensor([[0.95, 1.0, 1.02], [1.05, 1.0, 0.98], [0.97, 1.01, 1.0], [1.03, 0.99, 1.0]]))
    return gains


def group_config(**changes: object) -> Config:
    settings = {
        "group.length": FRAMES,
        "group.overlap": 0,
        "group.iterations_per_frame": 8,
        "group.coarse_share": 0.25,
        "layering.adapt_every": 10,
    }
    return changed(preset("standard"), settings | changes)


def group_trainer(
    gpu: SharedGpu | None,
    config: Config | None = None,
    static: Gaussians = WALL,
    images: TrainingImages | None = None,
) -> GroupTrainer:
    rng = np.random.default_rng(3)
    paths = np.stack([moved(THING, frame).means for frame in range(FRAMES)])
    tracks = (paths + rng.normal(0, 0.01, paths.shape)).astype(np.float32)
    offsets = TimeOffsets(len(CAMERAS))
    offsets.load(np.array([0.1, -0.2, 0.15, -0.05]))
    return GroupTrainer(
        images or make_images(FRAMES),
        GroupStart(THING, tracks),
        StaticPoints(static, np.ones(len(static), bool)),
        config or group_config(),
        gains=camera_gains(False),
        time_offsets=offsets,
        gpu=gpu,
    )


def keyframe_trainer(gpu: SharedGpu | None, losses=KEYFRAME, static: Gaussians | None = None, **changes: object):
    start = THING if static is not None else Gaussians.concatenate([WALL, THING])
    noise = np.random.default_rng(4).normal(0, 0.02, start.means.shape)
    start = replace(start, means=(start.means + noise).astype(np.float32))
    points = TrainablePoints.from_gaussians(start, default_rates(UNIT, 4.0), CPU)
    config = changed(preset("standard"), {"keyframe.densify_every": 10, **changes}).keyframe
    return KeyframeTrainer(points, camera_gains(True), config, static=static, max_points=600, losses=losses, gpu=gpu)


def difference(found: Adam, expected: Adam) -> float:
    """Return the relative difference of the first moments: of the gradients so far."""
    assert found.tensor.shape == expected.tensor.shape
    assert found.steps == expected.steps
    size = float(expected.mean.norm())
    return float((found.mean - expected.mean).norm()) / size if size > 1e-9 else float(found.mean.norm())


def group_adams(trainer: GroupTrainer) -> dict[str, Adam]:
    points = trainer.points
    assert points.appearance is not None
    nodes, motion = points.deformation.adams  # type: ignore[union-attr]
    return points.canonical.adams | {"nodes": nodes, "motion": motion, "appearance": points.appearance.adam}


def _scatter(trainer: GroupTrainer) -> None:
    """Change the motion at random, so that no value is so close to 0 that its sign is chance."""
    rng = np.random.default_rng(5)
    for name in ("nodes", "motion", "appearance"):
        values = group_adams(trainer)[name].tensor.detach()
        values.add_(torch.from_numpy(rng.normal(0, 0.02, values.shape).astype(np.float32)))


@pytest.mark.parametrize("unknown", [False, True], ids=["", "with unknown pixels"])
@pytest.mark.parametrize("opened", [ON_CPU, *DEVICES])
def test_an_iteration_of_a_group_is_that_of_torch(opened: Callable[[], Gpu] | None, unknown: bool) -> None:
    """Offsets, projection, order among static points, loss, all gradients, rigidity, smoothness and Adam."""
    config = group_config(**{"group.coarse_share": 0.0, "group.progressive_share": 0.0})
    shown = make_images(FRAMES, unknown=unknown)
    trainers = [group_trainer(gpu, config, images=shown) for gpu in (opened and OpenedGpu(opened()), None)]
    device, host = trainers
    for trainer in trainers:
        _scatter(trainer)
    device.start_program(Silent())
    assert device.program is not None
    for iteration, parts in ((0, "rigidity, gradients of static points"), (1, "smoothness"), (49, "the whole image")):
        for trainer in trainers:
            trainer.rng, trainer.schedule.rng = np.random.default_rng(iteration), np.random.default_rng(iteration)
            trainer.schedule._round.clear()
        draw = device.plan(iteration)
        draw = replace(draw, metered=True, metered_static=iteration == 0)
        device.program.neighbors = host.neighbors
        device.density.restart()
        device.program.upload()
        outcome = device.program.run([draw])[0]
        device.program.give_meters()
        device.program.download()
        host.density.measures = lambda iteration: True  # pyright: ignore[reportAttributeAccessIssue]
        host.density.restart()
        loss = host.step(iteration)
        assert outcome.loss == pytest.approx(float(loss), rel=CLOSE), parts
        found, expected = group_adams(device), group_adams(host)
        for name, adam in expected.items():
            assert difference(found[name], adam) < CLOSE, (parts, name)
            adam.rewrite(lambda rows: rows, lambda rows: rows)
        meter = host.density.moving_meter
        torch.testing.assert_close(device.density.moving_meter.sum, meter.sum, rtol=1e-3, atol=1e-6)
        torch.testing.assert_close(device.density.moving_meter.seen, meter.seen)
        if iteration == 0:
            chosen = host.density.convertible
            measured = device.density.static_meter.sum[chosen]
            torch.testing.assert_close(measured, host.density.static_meter.sum[chosen], rtol=1e-3, atol=1e-6)
        camera, slope = host.time_offsets._pending.pop()
        assert (camera, outcome.slope) == (draw.camera, pytest.approx(float(slope), rel=1e-2, abs=1e-7))
        for name, adam in expected.items():  # the same state for the next iteration
            with torch.no_grad():
                found[name].tensor.detach().copy_(adam.tensor)
                found[name].mean.copy_(adam.mean)
                found[name].square.copy_(adam.square)


def test_draws_together_start_from_one_state_and_are_followed_in_turn() -> None:
    """Two draws of different views, and two of one view, with one thread and with several."""
    for cameras in ((0, 1), (2, 2)):
        found = []
        for limit in (1, 4):
            trainer = group_trainer(None, group_config(**{"group.coarse_share": 0.0}))
            _scatter(trainer)
            trainer.start_program(Silent())
            assert trainer.program is not None
            draws = [replace(trainer.plan(40 + k), camera=camera) for k, camera in enumerate(cameras)]
            alone = trainer.program.gradients(draws[1], trainer.program.prepare(draws[1])).outcome  # type: ignore[union-attr]
            with threads.limited(limit):
                outcomes = trainer.program.run(draws)
            assert outcomes[1] == alone, "the second draw does not see the first one's step"
            adams = group_adams(trainer)
            assert {adam.steps for adam in adams.values()} == {2}
            found.append({name: adam.tensor.detach().clone() for name, adam in adams.items()})
        for name, tensor in found[0].items():
            assert torch.equal(tensor, found[1][name]), (cameras, name)


def test_draws_of_a_keyframe_start_from_one_state() -> None:
    """Whole images, and parts of one view before static points, with one thread and with several."""
    shown = make_images(1)
    for static, cameras in ((None, (0, 1)), (WALL, (2, 2))):
        found = []
        for limit in (1, 4):
            trainer = keyframe_trainer(None, CHAPTER_KEYFRAME, static)
            trainer.density.restart(shown)
            trainer._start_program(shown, trainer._static_cache(shown), Silent())
            program = trainer.program
            assert isinstance(program, CpuKeyframeProgram)
            plans = [trainer._plan(shown, 41 + k, 100, Average(0.0, 100)) for k in range(2)]
            draws = [replace(plan, camera=camera) for plan, camera in zip(plans, cameras, strict=True)]
            alone = program.gradients(draws[1], program.prepare(draws[1])).compared.loss
            with threads.limited(limit):
                assert program.run(draws)[1].loss == alone, "the second draw does not see the first one's step"
            assert {adam.steps for adam in trainer.points.adams.values()} == {2}
            found.append({name: tensor.detach().clone() for name, tensor in trainer.points.params.items()})
        for name, tensor in found[0].items():
            assert torch.equal(tensor, found[1][name]), (cameras, name)


@pytest.mark.parametrize("opened", [ON_CPU, *REAL])
def test_a_subject_of_few_cameras_has_opposite_backgrounds_in_turn(opened: Callable[[], Gpu] | None) -> None:
    config = group_config(**{"group.coarse_share": 0.0, "group.progressive_share": 0.0})
    alpha = np.full((FRAMES, len(CAMERAS), 32, 48), 255, np.uint8)
    alpha[..., :20] = 0
    device, host = (
        group_trainer(gpu, config, images=with_opposite(make_images(FRAMES), alpha))
        for gpu in (opened and OpenedGpu(opened()), None)
    )
    for trainer in (device, host):
        _scatter(trainer)
    device.start_program(Silent())
    assert device.program is not None
    losses = []
    for iteration in (3, 4):  # the last over the first backgrounds, and the first over the opposite ones
        for trainer in (device, host):
            trainer.rng, trainer.schedule.rng = np.random.default_rng(0), np.random.default_rng(0)
            trainer.schedule._round.clear()
        device.program.neighbors = host.neighbors
        losses.append(device.program.run([device.plan(iteration)])[0].loss)
        device.program.download()
        assert losses[-1] == pytest.approx(float(host.step(iteration)), rel=CLOSE)
        for name, adam in group_adams(host).items():
            assert difference(group_adams(device)[name], adam) < CLOSE, name
    assert losses[0] != pytest.approx(losses[1], rel=0.01), "the backgrounds differ"


@pytest.mark.parametrize(
    ("losses", "static", "unknown"),
    [(KEYFRAME, False, False), (KEYFRAME, False, True), (CHAPTER_KEYFRAME, True, False)],
    ids=["first", "with unknown pixels", "before static points"],
)
@pytest.mark.parametrize("opened", [ON_CPU, *DEVICES])
def test_an_iteration_of_a_keyframe_is_that_of_torch(
    opened: Callable[[], Gpu] | None, losses, static: bool, unknown: bool
) -> None:
    """Losses of surfaces and opacity, color gains, absolute gradients and steps scaled by distance."""
    shown = make_images(1, unknown=unknown)
    trainers = [
        keyframe_trainer(gpu, losses, WALL if static else None) for gpu in (opened and OpenedGpu(opened()), None)
    ]
    caches = [trainer._static_cache(shown) for trainer in trainers]
    for trainer, cache in zip(trainers, caches, strict=True):
        trainer.density.restart(shown)
        trainer.density.distances = torch.linspace(1, 3, len(trainer.points))
        trainer._start_program(shown, cache, Silent())
    device, host = trainers
    assert device.program is not None
    camera, total = 2, 100
    for done in (0, 64, 66) if not static else (0, 65):
        whole = not static or done % 4 == 0
        host.done = done
        host._anneal(done / total)
        loss, drawing = host.step(shown, camera, caches[1], done / total)
        host.density.measure(0.0, drawing, shown.views[camera])
        device.done = done
        device._cameras = [camera]
        draw = replace(device._plan(shown, done, total, Average(0.0, total)), whole=whole, metered=True)
        outcome = device.program.run([draw])[0]
        device.program.give_meters()
        device.program.download()
        assert outcome.loss == pytest.approx(float(loss), rel=CLOSE)
        for name, adam in host.points.adams.items():
            assert difference(device.points.adams[name], adam) < (SURFACES_CLOSE if done else CLOSE), (done, name)
        torch.testing.assert_close(device.gains.values, host.gains.values, rtol=0, atol=2e-5)
        measured = host.density.meter.sum
        assert float((device.density.meter.sum - measured).norm()) < SURFACES_CLOSE * float(measured.norm())
        _align(device, host)
        device.program.upload()
        device.density.restart(shown)
        host.density.restart(shown)
        for trainer in trainers:
            trainer.density.distances = torch.linspace(1, 3, len(trainer.points))


def _align(device: KeyframeTrainer, host: KeyframeTrainer) -> None:
    """Give the device's trainer the exact state of the other one, so that rounding does not add up."""
    for name, adam in host.points.adams.items():
        other = device.points.adams[name]
        with torch.no_grad():
            other.tensor.detach().copy_(adam.tensor)
            other.mean.copy_(adam.mean)
            other.square.copy_(adam.square)
    device.gains.load(host.gains.values)


@pytest.mark.parametrize("opened", DEVICES)
def test_a_batch_runs_again_where_its_pairs_did_not_fit(
    opened: Callable[[], Gpu], monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = group_trainer(OpenedGpu(opened()))
    trainer.start_program(Silent())
    program = trainer.program
    assert isinstance(program, GpuGroupProgram)
    draws = [trainer.plan(iteration) for iteration in range(3)]
    before = {name: adam.tensor.detach().clone() for name, adam in group_adams(trainer).items()}
    expected = program.run(draws)
    for adam in group_adams(trainer).values():
        adam.steps -= len(draws)
    for name, adam in group_adams(trainer).items():
        torch.testing.assert_close(adam.tensor.detach(), before[name], rtol=0, atol=0)  # the host is as it was
    program.upload()
    program.drawing.capacity = 16  # far too few
    monkeypatch.setattr(gpu_program, "FIRST_PAIRS", 0)
    np.testing.assert_allclose(program.run(draws), expected, rtol=1e-5)
    assert program.drawing.capacity > 16


def test_nan_returns_to_the_last_good_state(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = group_trainer(OpenedGpu())
    trainer.start_program(Silent())
    program = trainer.program
    assert program is not None
    with torch.no_grad():
        trainer.points.canonical.adams["log_scales"].tensor[3, 1] = torch.nan
    program.upload()
    with pytest.raises(GaussiansError, match="not finite"):
        program.run([trainer.plan(0)])
    with torch.no_grad():
        trainer.points.canonical.adams["log_scales"].tensor[3, 1] = -2.0
    program.upload()
    assert np.isfinite(program.run([trainer.plan(1)])[0].loss)
