"""Iterations with gsplat, whose kernels a stand-in computes, against those of the CPU's programs."""

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")

from splatreel.capture.masks import LIKELY
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.method.train.losses import CHAPTER_KEYFRAME, KEYFRAME, Terms
from splatreel.method.train.subject import with_opposite
from splatreel.run.device_choice import pick_gpu
from splatreel.scene.gaussians import Gaussians
from tests.method.train.parity import compare_groups, compare_keyframes
from tests.method.train.trainers import (
    CAMERAS,
    FRAMES,
    WALL,
    Notes,
    group_config,
    group_trainer,
    keyframe_trainer,
    make_images,
)
from tests.standin.device import WAITS
from tests.standin.gpu import gpu

REAL = pytest.importorskip("torch").cuda.is_available()
"""There is a GPU, which is used instead of the stand-in."""
PLAIN = {"group.coarse_share": 0.0, "group.progressive_share": 0.0}


@pytest.fixture
def cuda() -> Iterator[SharedGpu]:
    with nullcontext() if REAL else gpu():
        found, note = pick_gpu("cuda")
        assert found is not None
        assert (found.kind, note) == ("cuda", "")
        yield found


@pytest.mark.parametrize("unknown", [False, True], ids=["", "with unknown pixels"])
def test_an_iteration_of_a_group_is_that_of_the_cpu(cuda: SharedGpu, unknown: bool) -> None:
    shown = make_images(FRAMES, unknown=unknown)
    device, host = (group_trainer(each, group_config(**PLAIN), images=shown) for each in (cuda, None))
    compare_groups(device, host, (0, 1, 49))


def test_a_group_over_opposite_backgrounds(cuda: SharedGpu) -> None:
    alpha = np.full((FRAMES, len(CAMERAS), 32, 48), 255, np.uint8)
    alpha[..., :20] = 0
    shown = with_opposite(make_images(FRAMES), alpha)
    device, host = (group_trainer(each, group_config(**PLAIN), images=shown) for each in (cuda, None))
    compare_groups(device, host, (3, 4))


@pytest.mark.parametrize(
    ("losses", "static", "unknown"),
    [(KEYFRAME, False, False), (KEYFRAME, False, True), (CHAPTER_KEYFRAME, True, False)],
    ids=["first", "with unknown pixels", "before static points"],
)
def test_an_iteration_of_a_keyframe_is_that_of_the_cpu(
    cuda: SharedGpu, losses: Terms, static: bool, unknown: bool
) -> None:
    device, host = (keyframe_trainer(each, losses, WALL if static else None, **DETAIL) for each in (cuda, None))
    compare_keyframes(device, host, make_images(1, unknown=unknown), (0, 65) if static else (0, 64, 66), static)


DETAIL = {"keyframe.detail": not REAL}
"""The absolute gradients of gsplat are summed over pixels, those of the CPU and of the stand-in over tiles."""


@pytest.mark.parametrize("static", [None, WALL], ids=["first", "before static points"])
def test_an_iteration_of_a_subject_is_that_of_the_cpu(cuda: SharedGpu, static: Gaussians | None) -> None:
    """Backgrounds that were divided by a known gain, opposite backgrounds, pixels in doubt, and bounded colors."""
    alpha = np.full((1, len(CAMERAS), 32, 48), 255, np.uint8)
    alpha[..., :20], alpha[..., 20:24] = 0, LIKELY
    images = make_images(1)
    views = [replace(view, gain=np.array([0.9, 1.1, 1.0], np.float32)) for view in images.views]
    shown = with_opposite(replace(images, views=views), alpha)
    device, host = (keyframe_trainer(each, CHAPTER_KEYFRAME, static, **DETAIL) for each in (cuda, None))
    compare_keyframes(device, host, shown, (3, 4), static=False)


def test_iterations_do_not_wait_for_the_device(cuda: SharedGpu) -> None:
    """Apart from the first look of a view at the static points, and one question for each draw among them."""
    trainer = group_trainer(cuda, group_config(**PLAIN))
    trainer.start_program(Notes())
    assert trainer.program is not None
    draws = [trainer.plan(iteration) for iteration in range(16)]
    trainer.program.run(draws)
    before = sum(WAITS.values())
    trainer.program.run(draws)
    assert sum(WAITS.values()) - before <= len(draws) + 1


def test_what_gsplat_lacks_is_trained_on_the_cpu(cuda: SharedGpu) -> None:
    notes, config = Notes(), group_config(**{"group.tracks": False, "group.deformation": "hashgrid"})
    trainer = group_trainer(cuda, config)
    trainer.start_program(notes)
    assert type(trainer.program).__name__ == "CpuGroupProgram"
    assert notes.notes[-1] == "this group is trained on the CPU: the hash grid runs on the CPU"


def test_a_group_without_tracks_extends_its_motion(cuda: SharedGpu) -> None:
    config = group_config(**{"group.tracks": False})
    device, host = (group_trainer(each, config) for each in (cuda, None))
    for trainer in (device, host):
        trainer.start_program(Notes())
        draw = replace(trainer.plan(3), frame=FRAMES - 1, moment=FRAMES - 1.0, last=FRAMES - 1, rank=None, span=None)
        assert trainer.program is not None
        trainer.program.run([draw])
        trainer.program.download()
    found, expected = (trainer.points.deformation for trainer in (device, host))
    assert found.reached == expected.reached  # type: ignore[union-attr]
    for a, b in zip(found.adams, expected.adams, strict=True):  # type: ignore[union-attr]
        np.testing.assert_allclose(a.values, b.values, atol=1e-5)
