"""Whole iterations of the programs of keyframes, on a (software) GPU against the CPU."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from splatreel.base import threads
from splatreel.base.progress import Silent
from splatreel.gpu.device import Gpu
from splatreel.method.train.average import Average
from splatreel.method.train.cpu_keyframe import CpuKeyframeProgram
from splatreel.method.train.losses import CHAPTER_KEYFRAME, KEYFRAME, Terms
from tests.gpu.devices import DEVICES, OpenedGpu
from tests.method.train.parity import compare_keyframes
from tests.method.train.trainers import WALL, keyframe_trainer, make_images


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
