"""Lists of losses: their schedule, weights and gradients."""

from dataclasses import fields

import numpy as np
import pytest
import torch

from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.dynamic_points import DynamicPoints
from splatreel.method.train.losses import GROUP, KEYFRAME, KEYFRAME_BEFORE_STATIC, GroupStep, Loss, backward
from splatreel.method.train.regularizers import Neighbors
from splatreel.method.train.render import View, draw
from splatreel.method.train.training_images import TrainingImages
from tests.method.scenes import random_gaussians, ring

CPU = torch.device("cpu")


def group_step(iteration: int, share: float = 0.5, frames: int = 4, seed: int = 0) -> GroupStep:
    """Return a step of a group with a few points and an empty background."""
    views = [View.of(camera, CPU) for camera in ring(1, width=32, height=32)]
    images = TrainingImages(torch.zeros(frames, 1, 32, 32, 3, dtype=torch.uint8), views, 0.1, 4.0)
    points = DynamicPoints.of(GroupStart(random_gaussians(20, seed)), images, GroupConfig(), seed)
    changes = points.changes(0.0)
    drawing = draw(points.splats(changes, views[0], 0.1), views[0])
    return GroupStep(
        iteration=iteration,
        share=share,
        view=views[0],
        drawing=drawing,
        target=images.pixels[0, 0],
        gain=None,
        lambda_dssim=0.2,
        unit=4.0,
        points=points,
        changes=changes,
        neighbors=Neighbors.of(points.means, 8),
        frame=0,
        frames=frames,
        last=frames - 1,
        rng=np.random.default_rng(seed),
    )


@pytest.mark.parametrize(
    ("losses", "config"), [(KEYFRAME, KeyframeConfig), (KEYFRAME_BEFORE_STATIC, KeyframeConfig), (GROUP, GroupConfig)]
)
def test_loss_weights_are_configuration_fields(losses: tuple[Loss, ...], config: type) -> None:
    known = {field.name for field in fields(config)}
    assert {loss.weight for loss in losses if loss.weight} <= known
    assert len({loss.name for loss in losses}) == len(losses)


def test_loss_weight_is_multiplied_by_every() -> None:
    loss = Loss("some", lambda step, weight: None, "lambda_arap", every=8, first=1)
    config = GroupConfig(lambda_arap=0.25)
    assert [loss.weight_at(group_step(n), config) for n in (0, 1, 2, 9)] == [0, 2, 0, 2]
    late = Loss("some", lambda step, weight: None, after=0.5)
    assert [late.weight_at(group_step(0, share), config) for share in (0.4, 0.5, 0.6)] == [0, 0, 1]


def test_group_losses_run_by_schedule_and_weight() -> None:
    config = GroupConfig(lambda_sh=0.0)
    assert set(backward(GROUP, group_step(0), config)) == {"photometric", "rigidity"}
    assert set(backward(GROUP, group_step(1), config)) == {"photometric", "smoothness"}
    assert set(backward(GROUP, group_step(3), config)) == {"photometric"}
    assert set(backward(GROUP, group_step(0), GroupConfig(lambda_arap=0.0))) == {"photometric"}
    assert set(backward(GROUP, group_step(1, frames=2), config)) == {"photometric"}


def test_loss_on_gradients_adds_to_existing_gradients() -> None:
    free, priced = group_step(3), group_step(3)
    backward(GROUP, free, GroupConfig(lambda_sh=0.0))
    assert set(backward(GROUP, priced, GroupConfig(lambda_sh=2.0))) == {"photometric"}
    rest, before = (step.points.canonical.params["sh_rest"] for step in (priced, free))
    assert rest.grad is not None
    assert before.grad is not None
    torch.testing.assert_close(rest.grad - before.grad, rest.detach().sign() * 2 / (32 * 32))


def test_backward_returns_losses_with_gradients() -> None:
    step = group = group_step(0)
    left, right = (Loss(name, lambda step, weight: weight * group.points.means.sum()) for name in ("left", "right"))
    nothing = Loss("nothing", lambda step, weight: None)
    found = backward((left, nothing, right), step, GroupConfig())
    assert list(found) == ["left", "right"]
    assert step.points.means.grad is not None
    assert (step.points.means.grad == 2).all()
