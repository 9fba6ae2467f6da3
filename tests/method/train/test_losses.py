"""Terms of training: their lists, schedules and weights, and their gradients on the CPU and on GPUs."""

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import UsageError
from splatreel.base.progress import Silent
from splatreel.config import GroupConfig, KeyframeConfig
from splatreel.method.deform.knot_adam import Adam
from splatreel.method.train import group_trainer as groups
from splatreel.method.train import keyframe_trainer as keyframes
from splatreel.method.train import losses as lists
from splatreel.method.train import terms
from splatreel.method.train.keyframe_trainer import Average
from splatreel.method.train.losses import CHAPTER_KEYFRAME, GROUP, KEYFRAME, KEYFRAME_BEFORE_STATIC, Terms, weight_of
from splatreel.method.train.terms.custom import Custom, Seen
from splatreel.method.train.terms.photometric import Photometric
from splatreel.method.train.terms.rigidity import Rigidity
from splatreel.method.train.terms.surfaces import Spread
from splatreel.method.train.terms.term import Term
from splatreel.run.pipeline import reconstruct
from splatreel.training import group_trainer as public_group_trainer
from splatreel.training import reconstruct_frame
from tests.gpu.devices import OpenedGpu
from tests.method.captures import WallCapture
from tests.method.small import small
from tests.method.train.trainers import (
    FRAMES,
    SURFACES_CLOSE,
    THING,
    WALL,
    Notes,
    difference,
    group_adams,
    group_config,
    group_trainer,
    keyframe_trainer,
    make_images,
)

EVERYTHING = {"group.lambda_arap": 0.3, "group.lambda_temporal": 0.3, "group.lambda_sh": 0.3}
"""Weights of a group, none of them 0."""
WEIGHTS = {"keyframe.lambda_opacity": 0.3, "keyframe.lambda_spread": 1.0, "keyframe.lambda_roughness": 0.3}


def moment(iteration: int, share: float = 0.5) -> Any:
    return SimpleNamespace(iteration=iteration, share=share)


@pytest.mark.parametrize(
    ("losses", "config"),
    [
        (KEYFRAME, KeyframeConfig),
        (CHAPTER_KEYFRAME, KeyframeConfig),
        (KEYFRAME_BEFORE_STATIC, KeyframeConfig),
        (GROUP, GroupConfig),
    ],
)
def test_weights_are_configuration_fields(losses: Terms, config: type) -> None:
    known = {field.name for field in fields(config)}
    assert {term.weight for term in losses if term.weight} <= known
    assert len({term.name for term in losses}) == len(losses)


def test_every_term_of_the_package_is_in_a_list() -> None:
    for module in pkgutil.iter_modules(terms.__path__):
        importlib.import_module(f"{terms.__name__}.{module.name}")
    defined = {kind for kind in Term.__subclasses__() if kind.__module__.startswith(terms.__name__)}
    assert defined == {type(term) for term in (*KEYFRAME, *GROUP)} | {Custom}


def test_a_weight_is_multiplied_by_every() -> None:
    config, term = GroupConfig(lambda_arap=0.25), Term("some", "lambda_arap", every=8, first=1)
    assert [term.weight_at(moment(n), config) for n in (0, 1, 2, 9)] == [0, 2, 0, 2]
    late = Term("some", after=0.5)
    assert [late.weight_at(moment(0, share), config) for share in (0.4, 0.5, 0.6)] == [0, 0, 1]
    pairs = Term("some", every=2, block=2)
    assert [pairs.weight_at(moment(n), config) for n in range(5)] == [2, 2, 0, 0, 2]


def test_terms_of_a_group_run_by_schedule_and_weight() -> None:
    def running(iteration: int, config: GroupConfig) -> set[str]:
        return {term.name for term in GROUP if term.weight_at(moment(iteration), config)}

    config = GroupConfig(lambda_sh=0.0)
    assert running(0, config) == {"photometric", "rigidity"}
    assert running(1, config) == {"photometric", "smoothness"}
    assert running(3, config) == {"photometric"}
    assert running(0, GroupConfig(lambda_arap=0.0)) == {"photometric", "view dependence"}


def test_weights_of_one_kind_are_added() -> None:
    stiff = Rigidity("a", "lambda_arap"), Rigidity("b", "lambda_temporal", every=3), Photometric("photometric")
    config = GroupConfig(lambda_arap=0.5, lambda_temporal=0.25)
    assert [weight_of(Rigidity, stiff, moment(n), config) for n in (0, 1)] == [1.25, 0.5]
    assert weight_of(Spread, stiff, moment(0), config) == 0


def always(term: Term[Any]) -> Term[Any]:
    """Return a term that runs in every iteration."""
    return replace(term, every=1, first=0, block=1, after=0.0)


def pull(seen: Seen) -> tuple[float, dict[str, np.ndarray]]:
    """A loss of a user on the image and on all points: the image shall be the target, and all values shall be 0."""
    parts = {"image": seen.image - seen.target / np.float32(255), **seen.points}
    value = sum(float(np.square(part).mean()) / 2 for part in parts.values() if part.size)
    return value, {name: part / max(part.size, 1) for name, part in parts.items()}


OWN = Custom("own", function=pull)
NUDGE = {"means": 0.01, "quats": 0.02, "log_scales": 0.05, "logit_opacities": 0.1, "sh_base": 0.05, "sh_rest": 0.02}
TOLERANCE: dict[str, float] = dict.fromkeys(("means", "quats", "log_scales", "nodes", "motion"), 0.15)
"""Relative differences. A splat ends where its alpha is 1/255, and its gradient does not know that this border moves."""
"""Sizes of the differences, by name; of splines they are 0.01."""


def check_gradients(adams: dict[str, Adam], run: Callable[[], object], value: Callable[[], float]) -> list[str]:
    """Compare gradients with finite differences along random directions. Return the names of the arrays with a gradient.

    Args:
        adams: Optimizers of all arrays, without steps so far. Their first moment after a step is a tenth of the gradient.
        run: Takes one optimizer step.
        value: Computes the value at the current state.
    """
    start = {name: adam.parameter.copy() for name, adam in adams.items()}
    run()
    slopes = {name: 10 * adam.mean for name, adam in adams.items()}
    rng, found = np.random.default_rng(0), []
    for name, slope in slopes.items():
        for other, adam in adams.items():
            adam.parameter[:] = start[other]
        if not slope.any():
            continue
        found.append(name)
        along = np.where(slope != 0, np.sign(slope), 0) * rng.uniform(0.2, 1, slope.shape)
        step, values = NUDGE.get(name, 0.01) / 8, []
        for factor in (step, -step):
            adams[name].parameter[:] = start[name] + (factor * along).astype(np.float32)
            values.append(value())
        expected = float((slope * along).sum())
        assert (values[0] - values[1]) / (2 * step) == pytest.approx(expected, rel=TOLERANCE.get(name, 0.03)), name
    for name, adam in adams.items():
        adam.parameter[:] = start[name]
    return found


GROUP_NAMES = {
    "photometric": {
        "means",
        "quats",
        "log_scales",
        "logit_opacities",
        "sh_base",
        "sh_rest",
        "nodes",
        "motion",
        "appearance",
    },
    "rigidity": {"nodes", "motion"},
    "smoothness": {"nodes", "motion"},
    "view dependence": {"sh_rest"},
    "own": {"means", "quats", "log_scales", "logit_opacities", "sh_base", "sh_rest", "nodes", "motion", "appearance"},
}


def scatter(trainer: groups.GroupTrainer) -> None:
    """Change the motion at random, so that no value is so close to 0 that its sign is chance."""
    rng = np.random.default_rng(5)
    for name in ("nodes", "motion", "appearance"):
        values = group_adams(trainer)[name].parameter
        values += rng.normal(0, 0.02, values.shape).astype(np.float32)


@pytest.mark.parametrize("term", [*GROUP, OWN], ids=lambda term: term.name)
def test_gradients_of_a_group_are_finite_differences(term: Term[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    config = group_config(**EVERYTHING, **{"group.coarse_share": 0.0, "group.progressive_share": 0.0})
    trainer = group_trainer(None, config, losses=[always(term)])
    scatter(trainer)
    trainer.start_program(Silent())
    program = trainer.program
    assert program is not None
    monkeypatch.setattr("splatreel.method.deform.appearance.LAMBDA", np.zeros(4, np.float32))  # a price that is no term
    draw = replace(trainer.plan(49), metered=False)
    assert draw.whole

    def value() -> float:
        return program.gradients(draw, program.prepare(draw)).outcome.loss  # type: ignore[attr-defined]

    names = check_gradients(group_adams(trainer), lambda: program.run([draw]), value)
    assert set(names) == GROUP_NAMES[term.name]


KEYFRAME_NAMES = {
    "photometric": GROUP_NAMES["photometric"] - {"nodes", "motion", "appearance"},
    "opacity": {"logit_opacities"},
    "own": GROUP_NAMES["photometric"] - {"nodes", "motion", "appearance"},
}


def started(trainer: keyframes.KeyframeTrainer) -> Any:
    """Return the program of a keyframe."""
    shown = make_images(1)
    trainer._cameras = [2]
    trainer.density.restart(shown)
    trainer._start_program(shown, trainer._static_cache(shown), Silent())
    return trainer.program


@pytest.mark.parametrize("static", [None, WALL], ids=["first", "before static points"])
@pytest.mark.parametrize("term", [*(term for term in KEYFRAME if term.exact), OWN], ids=lambda term: term.name)
def test_gradients_of_a_keyframe_are_finite_differences(term: Term[Any], static: Any) -> None:
    trainer = keyframe_trainer(None, [always(term)], static, **WEIGHTS)
    program = started(trainer)
    draw = replace(trainer._plan(make_images(1), 71, 100, Average(0.0, 100)), rates=(0.0,) * 6)
    adams = trainer.points.adams | {"gains": trainer.gains.adam}

    def value() -> float:
        return program.gradients(draw, program.prepare(draw)).loss

    names = check_gradients(adams, lambda: program.run([draw]), value)
    expected = KEYFRAME_NAMES[term.name] | ({"gains"} if term.name in ("photometric", "own") else set())
    assert set(names) == expected


@pytest.mark.parametrize("static", [None, WALL], ids=["first", "before static points"])
@pytest.mark.parametrize("term", [term for term in KEYFRAME if not term.exact], ids=lambda term: term.name)
def test_terms_of_surfaces_reach_the_points(term: Term[Any], static: Any) -> None:
    """`terms/test_depths.py` compares their gradients to depths with finite differences."""
    trainer = keyframe_trainer(None, [always(term)], static, **WEIGHTS)
    program = started(trainer)
    draw = trainer._plan(make_images(1), 71, 100, Average(0.0, 100))
    assert program.run([draw])[0].loss > 0
    moved = {name for name, adam in trainer.points.adams.items() if adam.mean.any()}
    assert moved == {"means", "quats", "log_scales", "logit_opacities"}


ON_GPU = pytest.param(OpenedGpu, id="wgpu")


def mine(seen: Seen) -> tuple[float, dict[str, np.ndarray]]:
    """A loss of a user that counts its calls."""
    mine.calls += 1  # type: ignore[attr-defined]
    return 0.0, {"sh_base": np.full_like(seen.points["sh_base"], 1e-3)}


@pytest.fixture
def counted() -> Custom:
    mine.calls = 0  # type: ignore[attr-defined]
    return Custom("mine", function=mine)


@pytest.mark.parametrize("opened", [None, ON_GPU])
def test_a_term_without_kernels_is_trained_on_the_cpu(opened: type[OpenedGpu] | None, counted: Custom) -> None:
    gpu, notes = opened and opened(), Notes()
    keyframe_trainer(gpu, (*KEYFRAME, counted)).train(make_images(1), 2, 2, notes)
    assert mine.calls == 2  # type: ignore[attr-defined]
    group = group_trainer(gpu, losses=(*GROUP, counted))
    group.start_program(notes)
    group.step(0)
    assert mine.calls == 3  # type: ignore[attr-defined]
    expected = ["this keyframe is trained on the CPU", "this group is trained on the CPU"] if gpu else []
    assert [note.partition(":")[0] for note in notes.notes if "trained" in note] == expected
    assert all("the kernels do not compute the loss mine" in note for note in notes.notes if "trained" in note)


def test_other_schedules_of_the_photometric_loss_are_trained_on_the_cpu() -> None:
    for photometric in (replace(GROUP[0], every=2), replace(GROUP[0], weight="lambda_arap")):
        notes, trainer = Notes(), group_trainer(OpenedGpu(), losses=(photometric, *GROUP[1:]))
        trainer.start_program(notes)
        assert "photometric loss other than once" in notes.notes[0]
        losses = [trainer.step(iteration) for iteration in range(3)]
        assert np.isfinite(losses).all()


def test_a_weighted_photometric_loss_scales_its_gradients() -> None:
    """Drawn as a whole, in tiles, and with static points that are measured."""
    config = group_config(**{"group.lambda_arap": 0.25, "group.coarse_share": 0.0, "group.progressive_share": 0.0})
    half = replace(GROUP[0], weight="lambda_arap")
    for changes in ({"whole": True}, {"whole": False}, {"whole": False, "metered_static": True}):
        found = []
        for losses in ([GROUP[0]], [half]):
            trainer = group_trainer(None, config, losses=losses)
            trainer.start_program(Silent())
            draw = replace(trainer.plan(0), **({"metered_static": False} | changes))
            outcome = trainer.program.run([draw])[0]  # type: ignore[union-attr]
            found.append((outcome.loss, group_adams(trainer)["sh_base"].mean))
        (loss, full), (same, quarter) = found
        assert loss == same, "the loss is shown without its weight"
        np.testing.assert_allclose(quarter, 0.25 * full, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("opened", [ON_GPU])
@pytest.mark.parametrize("term", GROUP[1:], ids=lambda term: term.name)
def test_a_gpu_computes_a_term_under_any_name_and_schedule(opened: type[OpenedGpu], term: Term[Any]) -> None:
    config = group_config(**EVERYTHING, **{"group.coarse_share": 0.0, "group.progressive_share": 0.0})
    losses = Photometric("image"), replace(always(term), name="mine", every=3)
    device, host = (group_trainer(gpu, config, losses=losses) for gpu in (opened(), None))
    for trainer in (device, host):
        scatter(trainer)
        trainer.start_program(Notes())
        trainer.schedule.draw = lambda iteration: (1, 2)  # type: ignore[method-assign]
        trainer.step(0)
        trainer.result()
    host_adams = group_adams(host)
    for name, adam in group_adams(device).items():
        assert difference(adam, host_adams[name]) < SURFACES_CLOSE, name


@pytest.mark.parametrize(
    ("gradients", "message"),
    [
        ({"alpha": np.zeros(3)}, "The loss own returns a gradient of 'alpha'. It may return image, means, "),
        ({"image": np.zeros((3, 3))}, r"gradient of image with shape \(3, 3\), expected \(32, 48, 3\)"),
    ],
)
def test_a_gradient_that_fits_nothing_is_named(gradients: dict[str, np.ndarray], message: str) -> None:
    own = Custom("own", function=lambda seen: (0.0, gradients))
    with pytest.raises(UsageError, match=message):
        group_trainer(None, group_config(**{"group.coarse_share": 0.0}), losses=[own]).step(0)


def test_a_loss_of_a_user_sees_the_points_and_the_image_of_a_camera() -> None:
    shown, found = make_images(FRAMES), list[Seen]()

    def look(seen: Seen) -> tuple[float, dict[str, np.ndarray]]:
        found.append(seen)
        for array in seen.points.values():
            array[:] = np.nan  # copies
        return 0.0, {}

    config = group_config(**{"group.coarse_share": 0.0})
    trainer = group_trainer(None, config, images=shown, losses=(*GROUP, Custom("look", function=look)))
    losses = [trainer.step(iteration) for iteration in range(2)]
    assert np.isfinite(losses).all()
    for iteration, seen in enumerate(found):
        assert (seen.iteration, seen.image.shape) == (iteration, seen.target.shape)
        assert np.array_equal(
            seen.target, shown.pixels[round(seen.moment - trainer.time_offsets.values[seen.camera]), seen.camera]
        )
        assert np.abs(seen.image - seen.target / 255).mean() < 0.2
    assert set(found[0].points) == {"means", "quats", "log_scales", "logit_opacities", "sh_base", "sh_rest", "dx", "dq"}


SHORT = small({"keyframe.first_iterations": 2, "group.iterations_per_frame": 2})


def test_a_loss_of_a_user_is_called_in_training_from_arrays(counted: Custom) -> None:
    capture = WallCapture(3)
    images = capture.read(0, 3, [camera.name for camera in capture.cameras])
    reconstruct_frame(images[0], capture.cameras, SHORT, points=THING.means, losses=[mine], device="cpu")
    assert mine.calls == 2  # type: ignore[attr-defined]
    given = images, capture.cameras, THING, None, SHORT
    public_group_trainer(*given, near=0.1, losses=[mine], device="cpu").train(Notes())
    assert mine.calls == 8  # type: ignore[attr-defined]
    with pytest.raises(UsageError, match="A loss is 'photometric'"):
        public_group_trainer(*given, near=0.1, losses=["photometric"], device="cpu")  # type: ignore[list-item]


@pytest.mark.slow
def test_a_line_added_to_a_list_is_called_in_runs(
    tmp_path: Path, counted: Custom, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, user in (("KEYFRAME", keyframes), ("GROUP", groups)):
        monkeypatch.setattr(user, name, (*getattr(lists, name), counted))
    reconstruct(WallCapture(3), tmp_path, SHORT, device="cpu")
    assert mine.calls == 8  # type: ignore[attr-defined]
