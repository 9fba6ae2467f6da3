"""Whole iterations of the programs of groups, on a (software) GPU against the CPU."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from splatreel.base import threads
from splatreel.base.errors import GaussiansError
from splatreel.base.progress import Silent
from splatreel.gpu.device import Gpu
from splatreel.method.train import gpu_program
from splatreel.method.train.cpu_program import CpuKeyframeProgram
from splatreel.method.train.gpu_program import GpuGroupProgram
from splatreel.method.train.keyframe_trainer import Average
from splatreel.method.train.losses import CHAPTER_KEYFRAME, KEYFRAME, Terms
from splatreel.method.train.subject import with_opposite
from tests.gpu.devices import DEVICES, REAL, OpenedGpu
from tests.method.train.parity import compare_groups, compare_keyframes, scatter
from tests.method.train.trainers import (
    CAMERAS,
    FRAMES,
    WALL,
    group_adams,
    group_config,
    group_trainer,
    keyframe_trainer,
    make_images,
    make_subject_images,
)


@pytest.mark.parametrize("unknown", [False, True], ids=["", "with unknown pixels"])
@pytest.mark.parametrize("opened", DEVICES)
def test_an_iteration_of_a_group_is_that_of_the_cpu(opened: Callable[[], Gpu], unknown: bool) -> None:
    """Offsets, projection, order among static points, loss, all gradients, rigidity, smoothness and Adam."""
    config = group_config(**{"group.coarse_share": 0.0, "group.progressive_share": 0.0})
    shown = make_images(FRAMES, unknown=unknown)
    device, host = (group_trainer(gpu, config, images=shown) for gpu in (OpenedGpu(opened()), None))
    # rigidity and gradients of static points; smoothness; the whole image
    compare_groups(device, host, (0, 1, 49))


def test_draws_together_start_from_one_state_and_are_followed_in_turn() -> None:
    """Two draws of different views, and two of one view, with one thread and with several."""
    for cameras in ((0, 1), (2, 2)):
        found = []
        for limit in (1, 4):
            trainer = group_trainer(None, group_config(**{"group.coarse_share": 0.0}))
            scatter(trainer)
            trainer.start_program(Silent())
            assert trainer.program is not None
            draws = [replace(trainer.plan(40 + k), camera=camera) for k, camera in enumerate(cameras)]
            alone = trainer.program.gradients(draws[1], trainer.program.prepare(draws[1])).outcome  # type: ignore[union-attr]
            with threads.limited(limit):
                outcomes = trainer.program.run(draws)
            assert outcomes[1] == alone, "the second draw does not see the first one's step"
            adams = group_adams(trainer)
            assert {adam.steps for adam in adams.values()} == {2}
            found.append({name: adam.parameter.copy() for name, adam in adams.items()})
        for name, array in found[0].items():
            assert np.array_equal(array, found[1][name]), (cameras, name)


@pytest.mark.parametrize("opened", REAL)
def test_a_subject_of_few_cameras_has_opposite_backgrounds_in_turn(opened: Callable[[], Gpu]) -> None:
    config = group_config(**{"group.coarse_share": 0.0, "group.progressive_share": 0.0})
    alpha = np.full((FRAMES, len(CAMERAS), 32, 48), 255, np.uint8)
    alpha[..., :20] = 0
    device, host = (
        group_trainer(gpu, config, images=with_opposite(make_images(FRAMES), alpha))
        for gpu in (OpenedGpu(opened()), None)
    )
    losses = compare_groups(device, host, (3, 4))  # the last over the first backgrounds, and the first over the others
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
    before = {name: adam.parameter.copy() for name, adam in group_adams(trainer).items()}
    expected = program.run(draws)
    for adam in group_adams(trainer).values():
        adam.steps -= len(draws)
    for name, adam in group_adams(trainer).items():
        np.testing.assert_array_equal(adam.parameter, before[name])  # the host is as it was
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
    scales = trainer.points.canonical.adams["log_scales"].parameter
    scales[3, 1] = np.nan
    program.upload()
    with pytest.raises(GaussiansError, match="not finite"):
        program.run([trainer.plan(0)])
    scales[3, 1] = -2.0
    program.upload()
    assert np.isfinite(program.run([trainer.plan(1)])[0].loss)


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
            alone = program.gradients(draws[1], program.prepare(draws[1])).loss
            with threads.limited(limit):
                assert program.run(draws)[1].loss == alone, "the second draw does not see the first one's step"
            assert {adam.steps for adam in trainer.points.adams.values()} == {2}
            found.append({name: array.copy() for name, array in trainer.points.params.items()})
        for name, array in found[0].items():
            assert np.array_equal(array, found[1][name]), (cameras, name)


@pytest.mark.parametrize(
    ("losses", "static", "unknown"),
    [(KEYFRAME, False, False), (KEYFRAME, False, True), (CHAPTER_KEYFRAME, True, False)],
    ids=["first", "with unknown pixels", "before static points"],
)
@pytest.mark.parametrize("opened", DEVICES)
def test_an_iteration_of_a_keyframe_is_that_of_the_cpu(
    opened: Callable[[], Gpu], losses: Terms, static: bool, unknown: bool
) -> None:
    """Losses of surfaces and opacity, color gains, absolute gradients and steps scaled by distance."""
    points = WALL if static else None
    device, host = (keyframe_trainer(gpu, losses, points) for gpu in (OpenedGpu(opened()), None))
    compare_keyframes(device, host, make_images(1, unknown=unknown), (0, 65) if static else (0, 64, 66), static)


@pytest.mark.parametrize(
    ("losses", "static"), [(KEYFRAME, False), (CHAPTER_KEYFRAME, True)], ids=["first", "before static points"]
)
@pytest.mark.parametrize("opened", DEVICES)
def test_an_iteration_of_a_keyframe_with_masks_is_that_of_the_cpu(
    opened: Callable[[], Gpu], losses: Terms, static: bool
) -> None:
    """Gains of the backgrounds, which the points do not share; bounded colors; both backgrounds in turn."""
    points = WALL if static else None
    device, host = (keyframe_trainer(gpu, losses, points) for gpu in (OpenedGpu(opened()), None))
    for trainer in (device, host):
        trainer.points.params["sh_base"][:9] = 3.0  # out of bounds
    compare_keyframes(device, host, make_subject_images(), (0, 4, 69) if static else (0, 4, 68), static)
