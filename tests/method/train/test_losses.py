"""Lists of losses: their schedule, weights and gradients."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import torch

from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train import group_trainer as groups
from splatreel.method.train import keyframe_trainer as keyframes
from splatreel.method.train import losses as lists
from splatreel.method.train.dynamic_points import DynamicPoints
from splatreel.method.train.losses import (
    GROUP,
    KEYFRAME,
    KEYFRAME_BEFORE_STATIC,
    GroupStep,
    Loss,
    Step,
    backward,
    photometric,
    rigidity,
)
from splatreel.method.train.regularizers import Neighbors
from splatreel.method.train.render import View, draw
from splatreel.method.train.training_images import TrainingImages
from splatreel.run.pipeline import reconstruct
from splatreel.training import group_trainer as public_group_trainer
from splatreel.training import reconstruct_frame
from tests.gpu.devices import OpenedGpu
from tests.method.captures import WallCapture
from tests.method.scenes import random_gaussians, ring
from tests.method.small import small
from tests.method.train.trainers import (
    ON_CPU,
    SURFACES_CLOSE,
    THING,
    Notes,
    difference,
    group_adams,
    group_trainer,
    keyframe_trainer,
    make_images,
)

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


def test_losses_of_one_name_are_added() -> None:
    step = group = group_step(0)
    same = [Loss("same", lambda step, weight: weight * group.points.means.sum()) for _ in range(2)]
    backward(same, step, GroupConfig())
    assert step.points.means.grad is not None
    assert (step.points.means.grad == 2).all()


class Counted:
    """Loss that counts its calls."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, step: Step, weight: float) -> torch.Tensor:
        self.calls += 1
        return weight * photometric(step, 1.0)


ON_GPU = pytest.param(OpenedGpu, id="wgpu")


def with_counted(losses: tuple[Loss, ...], place: str, counted: Counted) -> tuple[Loss, ...]:
    """Return a list with a counted loss: at its end, under a known name, in the place of a loss, or of the photometric one."""
    if place == "replaced":
        return (losses[0], Loss(losses[1].name, counted), *losses[2:])
    if place == "photometric":
        return (Loss("photometric", counted), *losses[1:])
    return (*losses, Loss("mine" if place == "added" else losses[1].name, counted))


@pytest.mark.parametrize("place", ["added", "same name", "replaced", "photometric"])
@pytest.mark.parametrize("opened", [ON_CPU, ON_GPU])
def test_a_loss_that_the_programs_do_not_compute_is_called(opened: type[OpenedGpu] | None, place: str) -> None:
    gpu, counted, notes = opened and opened(), Counted(), Notes()
    keyframe = keyframe_trainer(gpu, with_counted(KEYFRAME, place, counted))
    keyframe.train(make_images(1), 2, 2, notes)
    assert counted.calls == 2
    group = group_trainer(gpu, losses=with_counted(GROUP, place, counted))
    group.start_program(notes)
    assert group.program is None
    group.step(0)
    assert counted.calls == 3
    where = "on the CPU" if gpu else "with torch, which takes longer"
    assert [note.partition(":")[0] for note in notes.notes] == [
        f"this keyframe is trained {where}",
        f"this group is trained {where}",
    ]
    assert all("the kernels do not compute the" in note for note in notes.notes)


@pytest.mark.parametrize("opened", [ON_CPU, ON_GPU])
def test_programs_compute_their_losses_under_any_name_and_schedule(opened: type[OpenedGpu] | None) -> None:
    losses = (Loss("image", photometric), Loss("stiff", rigidity, "lambda_temporal", every=3))
    device, host = group_trainer(opened and opened(), losses=losses), group_trainer(None, losses=losses)
    device.start_program(Notes())
    assert device.program is not None
    for trainer in (device, host):
        trainer.schedule.draw = lambda iteration: (1, 2)  # type: ignore[method-assign]
    device.program.run([device.plan(0)])
    device.program.download()
    host.step(0)
    host_adams = group_adams(host)
    for name, adam in group_adams(device).items():
        assert difference(adam, host_adams[name]) < SURFACES_CLOSE, name


@pytest.fixture
def added(monkeypatch: pytest.MonkeyPatch) -> tuple[Counted, Counted]:
    """Return losses that are added to the end of `KEYFRAME` and of `GROUP`."""
    keyframe, group = Counted(), Counted()
    for name, counted, user in (("KEYFRAME", keyframe, keyframes), ("GROUP", group, groups)):
        monkeypatch.setattr(user, name, (*getattr(lists, name), Loss("mine", counted)))
    return keyframe, group


SHORT = small({"keyframe.first_iterations": 2, "group.iterations_per_frame": 2})


def test_a_line_added_to_a_list_is_called_in_training_from_arrays(added: tuple[Counted, Counted]) -> None:
    capture = WallCapture(3)
    images = capture.read(0, 3, [camera.name for camera in capture.cameras])
    reconstruct_frame(images[0], capture.cameras, SHORT, points=THING.means, device="cpu")
    public_group_trainer(images, capture.cameras, THING, None, SHORT, near=0.1, device="cpu").train(Notes())
    assert [counted.calls for counted in added] == [2, 6]


@pytest.mark.slow
def test_a_line_added_to_a_list_is_called_in_runs(tmp_path: Path, added: tuple[Counted, Counted]) -> None:
    reconstruct(WallCapture(3), tmp_path, SHORT, device="cpu")
    assert [counted.calls for counted in added] == [2, 6]
