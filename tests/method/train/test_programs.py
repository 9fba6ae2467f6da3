"""Whole iterations of the programs of groups, on a (software) GPU and on the CPU, against those of torch."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from splatreel.base import threads
from splatreel.base.errors import GaussiansError
from splatreel.base.progress import Silent
from splatreel.gpu.device import Gpu
from splatreel.method.train import gpu_program
from splatreel.method.train.gpu_group import GpuGroupProgram
from splatreel.method.train.group_trainer import GroupTrainer
from splatreel.method.train.opposite_backgrounds import with_opposite
from tests.gpu.devices import DEVICES, REAL, OpenedGpu
from tests.method.train.trainers import (
    CAMERAS,
    CLOSE,
    FRAMES,
    ON_CPU,
    difference,
    group_adams,
    group_config,
    group_trainer,
    make_images,
)


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
