"""Whole iterations of the programs of keyframes, on a (software) GPU and on the CPU, against those of torch."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from splatreel.base import threads
from splatreel.base.progress import Silent
from splatreel.capture.masked_capture import LIKELY
from splatreel.gpu.device import Gpu
from splatreel.method.train.average import Average
from splatreel.method.train.cpu_keyframe import CpuKeyframeProgram
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.losses import CHAPTER_KEYFRAME, KEYFRAME
from splatreel.method.train.opposite_backgrounds import with_opposite
from splatreel.scene.gaussians import Gaussians
from tests.gpu.devices import DEVICES, OpenedGpu
from tests.method.train.trainers import (
    CAMERAS,
    CLOSE,
    ON_CPU,
    SURFACES_CLOSE,
    WALL,
    difference,
    keyframe_trainer,
    make_images,
)


def test_draws_of_a_keyframe_start_from_one_state() -> None:
    """Whole images, and parts of one view before static points, with one thread and with several."""
    shown = make_images(1)
    for static, cameras in ((None, (0, 1)), (WALL, (2, 2))):
        found = []
        for limit in (1, 4):
            trainer = keyframe_trainer(None, CHAPTER_KEYFRAME, static)
            trainer._cameras = []
            trainer.density.restart(shown)
            trainer._start_program(shown, trainer._static_cache(shown), Silent())
            program = trainer.program
            assert isinstance(program, CpuKeyframeProgram)
            plans = [trainer._plan(shown, 70 + k, 100, Average(0.0, 100)) for k in range(2)]
            draws = [replace(plan, camera=camera) for plan, camera in zip(plans, cameras, strict=True)]
            alone = program.gradients(draws[1], program.prepare(draws[1])).compared.loss
            with threads.limited(limit):
                assert program.run(draws)[1].loss == alone, "the second draw does not see the first one's step"
            assert {adam.steps for adam in trainer.points.adams.values()} == {2}
            found.append({name: tensor.detach().clone() for name, tensor in trainer.points.params.items()})
        for name, tensor in found[0].items():
            assert torch.equal(tensor, found[1][name]), (cameras, name)


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


@pytest.mark.parametrize("static", [None, WALL], ids=["first", "before static points"])
def test_an_iteration_of_a_subject_is_that_of_torch(static: Gaussians | None) -> None:
    """Backgrounds that were divided by a known gain, opposite backgrounds, pixels in doubt, and bounded colors."""
    alpha = np.full((1, len(CAMERAS), 32, 48), 255, np.uint8)
    alpha[..., :20], alpha[..., 20:24] = 0, LIKELY
    images = make_images(1)
    views = [replace(view, gain=torch.tensor([0.9, 1.1, 1.0])) for view in images.views]
    shown = with_opposite(replace(images, views=views), alpha)
    device, host = (keyframe_trainer(None, CHAPTER_KEYFRAME, static) for _ in range(2))
    caches = [trainer._static_cache(shown) for trainer in (device, host)]
    for trainer in (device, host):
        trainer.density.restart(shown)
    device._start_program(shown, caches[0], Silent())
    assert device.program is not None
    for done in (3, 4):  # the last over the first backgrounds, and the first over the opposite ones
        host.done = device.done = done
        host._anneal(done / 100)
        loss, _ = host.step(shown, 2, caches[1], done / 100)
        device._cameras = [2]
        outcome = device.program.run([device._plan(shown, done, 100, Average(0.0, 100))])[0]
        assert outcome.loss == pytest.approx(float(loss), rel=CLOSE)
        for name, adam in host.points.adams.items():
            assert difference(device.points.adams[name], adam) < SURFACES_CLOSE, (done, name)
        torch.testing.assert_close(device.gains.values, host.gains.values, rtol=0, atol=2e-5)
        _align(device, host)


def _align(device: KeyframeTrainer, host: KeyframeTrainer) -> None:
    """Give the device's trainer the exact state of the other one, so that rounding does not add up."""
    for name, adam in host.points.adams.items():
        other = device.points.adams[name]
        with torch.no_grad():
            other.tensor.detach().copy_(adam.tensor)
            other.mean.copy_(adam.mean)
            other.square.copy_(adam.square)
    device.gains.load(host.gains.values)
