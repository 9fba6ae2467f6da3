"""Iterations of a program of a GPU compared with those of the CPU's program."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.method.deform.knot_adam import Adam
from splatreel.method.train.group_trainer import GroupTrainer
from splatreel.method.train.keyframe_trainer import Average, KeyframeTrainer
from splatreel.method.train.training_images import TrainingImages
from tests.method.train.trainers import CLOSE, SURFACES_CLOSE, difference, group_adams


def scatter(trainer: GroupTrainer) -> None:
    """Change the motion at random, so that no value is so close to 0 that its sign is chance."""
    rng = np.random.default_rng(5)
    for name in ("nodes", "motion", "appearance"):
        values = group_adams(trainer)[name].parameter
        values += rng.normal(0, 0.02, values.shape).astype(np.float32)


def compare_groups(device: GroupTrainer, host: GroupTrainer, iterations: Sequence[int]) -> list[float]:
    """Run single iterations of both from the same state, and compare losses, gradients, meters and time slopes.

    The gradients of static points are measured in iteration 0. Returns the losses.
    """
    for trainer in (device, host):
        scatter(trainer)
        trainer.start_program(Silent())
    losses = []
    for iteration in iterations:
        for trainer in (device, host):
            trainer.rng, trainer.schedule.rng = np.random.default_rng(iteration), np.random.default_rng(iteration)
            trainer.schedule._round.clear()
        draw = replace(device.plan(iteration), metered=True, metered_static=iteration == 0)
        outcomes = []
        for trainer in (device, host):
            program: Any = trainer.program
            program.neighbors = host.neighbors
            trainer.density.restart()
            program.upload()
            outcomes += program.run([draw])
            program.give_meters()
            program.download()
        found, expected = outcomes
        assert found.loss == pytest.approx(expected.loss, rel=CLOSE), iteration
        assert found.slope == pytest.approx(expected.slope, rel=1e-2, abs=1e-7), iteration
        align(group_adams(device), group_adams(host), CLOSE, iteration)
        meter, measured = host.density.moving_meter, device.density.moving_meter
        np.testing.assert_allclose(measured.sum, meter.sum, rtol=1e-3, atol=1e-6)
        np.testing.assert_array_equal(measured.seen, meter.seen)
        if iteration == 0:
            chosen = host.density.convertible
            measured, meter = device.density.static_meter, host.density.static_meter
            assert meter.sum[chosen].any()
            np.testing.assert_allclose(measured.sum[chosen], meter.sum[chosen], rtol=1e-3, atol=1e-6)
        losses.append(expected.loss)
    return losses


def compare_keyframes(
    device: KeyframeTrainer, host: KeyframeTrainer, shown: TrainingImages, iterations: Sequence[int], static: bool
) -> None:
    """Run single iterations of both from the same state, and compare losses, gradients, color gains and meters."""
    for trainer in (device, host):
        trainer.density.restart(shown)
        trainer.density.distances = np.linspace(1, 3, len(trainer.points), dtype=np.float32)
        trainer._start_program(shown, trainer._static_cache(shown), Silent())
    for done in iterations:
        outcomes = []
        for trainer in (device, host):
            trainer.done = done
            trainer._cameras = [2]
            trainer.density.meter.__init__(len(trainer.points))
            draw = trainer._plan(shown, done, 100, Average(0.0, 100))
            draw = replace(draw, whole=not static or done % 4 == 0, metered=True, average=1.0)
            program: Any = trainer.program
            program.upload()
            outcomes += program.run([draw])
            program.give_meters()
            program.download()
        found, expected = outcomes
        assert found.loss == pytest.approx(expected.loss, rel=CLOSE), done
        near = SURFACES_CLOSE if done else CLOSE
        np.testing.assert_allclose(device.gains.values, host.gains.values, rtol=0, atol=2e-5)
        np.testing.assert_allclose(device.points.means, host.points.means, rtol=0, atol=2e-3)
        np.testing.assert_allclose(device.points.params["sh_base"], host.points.params["sh_base"], rtol=0, atol=0.05)
        for mean, array in zip(device.program.averages(), device.points.params.values(), strict=True):  # type: ignore[union-attr]
            np.testing.assert_array_equal(mean, array)
        align(device.points.adams, host.points.adams, near, done)
        align({"gains": device.gains.adam}, {"gains": host.gains.adam}, near, done)
        measured = host.density.meter.sum
        assert np.linalg.norm(device.density.meter.sum - measured) < SURFACES_CLOSE * np.linalg.norm(measured)


def align(found: dict[str, Adam], expected: dict[str, Adam], close: float, iteration: int) -> None:
    """Compare the first moments, and give both the same state, so that rounding does not add up."""
    for name, adam in expected.items():
        assert difference(found[name], adam) < close, (iteration, name)
        found[name].parameter[...] = adam.parameter
        found[name].mean[...] = adam.mean
        found[name].square[...] = adam.square
