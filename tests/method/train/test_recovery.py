"""Recovery of training from injected NaN and infinity."""

import gc
import itertools
import weakref
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError, ReconstructionError
from splatreel.base.progress import Silent
from splatreel.kernels import photometric, splat
from splatreel.kernels.photometric import Gradient
from splatreel.method.train import recovery
from splatreel.method.train.dynamic_points import CANONICAL_RATES
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.programs import Draw
from splatreel.method.train.recovery import ATTEMPTS, Recovery
from tests.method.train import test_group_trainer as groups
from tests.method.train import test_keyframe_trainer as keyframes

LOSS_AND_GRADIENT = photometric.loss_and_gradient
TOTAL = 120


class Notes(Silent):
    def __init__(self) -> None:
        self.notes: list[str] = []
        self.done: list[int] = []

    def update(self, done: int, **numbers: float) -> None:
        self.done.append(done)

    def note(self, text: str) -> None:
        self.notes.append(text)


def spoil(monkeypatch: pytest.MonkeyPatch, bad: Callable[[int], bool], value: float = np.nan) -> None:
    """Multiply the loss of some comparisons, counted from 1, by NaN or infinity."""
    calls = itertools.count(1)  # programs of the CPU compare in two threads, and each call gets a number of its own

    def spoiled(*args: Any, **options: Any) -> Gradient:
        factor = value if bad(next(calls)) else 1.0
        found = LOSS_AND_GRADIENT(*args, **options)
        return replace(found, loss=found.loss * factor)

    monkeypatch.setattr(photometric, "loss_and_gradient", spoiled)
    monkeypatch.setattr(recovery, "KEEP_EVERY", 50)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_keyframe_recovers_last_good_state(monkeypatch: pytest.MonkeyPatch, value: float) -> None:
    def train(notes: Notes) -> KeyframeTrainer:
        trainer = KeyframeTrainer(keyframes.rough_start(), keyframes.gains(), keyframes.CONFIG, max_points=3000)
        trainer.train(keyframes.make_images(), TOTAL, TOTAL, notes)
        return trainer

    smooth = train(Notes()).points.gaussians()
    spoil(monkeypatch, lambda call: call == 95, value)
    notes = Notes()
    trainer = train(notes)
    found = trainer.points.gaussians()
    assert len(notes.notes) == 1
    assert "training continues from iteration 50, at 0.5 times its learning rates" in notes.notes[0]
    assert notes.done == [24, 48, 72, 72, 96, 120], "from 50 on again"
    assert trainer.recovery.pace == 1, "training has passed iteration 95"
    quality, usual = (np.mean([keyframes.psnr(g, camera) for camera in keyframes.CAMERAS]) for g in (found, smooth))
    assert quality > usual - 1.5


@pytest.mark.slow
@pytest.mark.parametrize(("deformation", "iterations"), [("trajectory", 48), ("hashgrid", 28)])
def test_group_recovers_last_good_state(monkeypatch: pytest.MonkeyPatch, deformation: str, iterations: int) -> None:
    """The state includes density control and the image size."""
    filmed = groups.frames()
    config = groups.with_group(
        groups.config(deformation, iterations, adapt_every=20), appearance=True, coarse_share=0.25
    )
    smooth = groups.trainer(filmed, config).train(Silent())
    spoil(monkeypatch, lambda call: call == 70)
    notes, group = Notes(), groups.trainer(filmed, config)
    found = group.train(notes)
    assert "continues from iteration 50, at 0.5 times" in notes.notes[0]
    assert group.recovery.pace == 1
    assert groups.quality(filmed, found) > groups.quality(filmed, smooth) - 1.5
    assert all(
        np.isfinite(array).all()
        for array in (found.dx, found.dq, found.shade, found.dynamic.means)
        if array is not None
    )


def test_second_failure_keeps_low_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    config = groups.with_group(groups.config(iterations=40), appearance=True)
    spoil(monkeypatch, lambda call: call in (70, 145))
    notes, group = Notes(), groups.trainer(groups.frames(), config)
    group.train(notes)
    assert "continues from iteration 100, at 0.25 times" in notes.notes[1]
    assert group.recovery.pace == 0.25
    last = 0.25 * 0.1 ** (199 / 200)
    assert group.points.canonical.adams["quats"].rate == pytest.approx(last * CANONICAL_RATES["quats"])
    assert group.points.appearance is not None
    assert group.points.appearance.adam.rate == pytest.approx(0.25 * 0.05 ** (199 / 200))


def test_recovery_reverts_converted_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that adaptive conversion made dynamic become static again."""
    group = groups.trainer(groups.frames(), groups.config(iterations=4))
    before, count, restore = group.static.view(0), len(group.points), group.snapshot()
    group.density.convert(np.arange(100))
    group.find_neighbors()
    assert (len(group.points), int(group.static.alive.sum())) == (count + 100, 300)
    for _ in range(2):
        restore()
        assert (len(group.points), int(group.static.alive.sum())) == (count, 400)
        np.testing.assert_array_equal(group.static.view(0).index, before.index)
        group.step(0)


@pytest.mark.parametrize("part", ["canonical", "deformation", "appearance"])
def test_recovery_detects_infinite_values_despite_finite_loss(monkeypatch: pytest.MonkeyPatch, part: str) -> None:
    """A gradient may be infinite although the loss is finite."""
    config = groups.with_group(groups.config(iterations=20), appearance=True)
    group, notes, spoiled = groups.trainer(groups.frames(), config), Notes(), []
    values = {
        "canonical": lambda: group.points.means,
        "deformation": lambda: group.points.deformation.controls[1],  # pyright: ignore[reportAttributeAccessIssue]
        "appearance": lambda: group.points.appearance.controls,
    }[part]
    run = group._run

    def spoiling(draws: Sequence[Draw]) -> float:
        loss = run(draws)
        if draws[-1].iteration >= 60 and not spoiled:
            spoiled.append(draws[-1].iteration)
            values()[..., 0] = np.inf
        return loss

    monkeypatch.setattr(group, "_run", spoiling)
    found = group.train(notes)
    assert "continues from iteration 0, at 0.5 times" in notes.notes[0]
    assert int(notes.notes[0].split("at iteration ")[1].split()[0]) in range(61, 101)
    assert np.isfinite(found.dx).all()


def test_recovery_gives_up_after_max_attempts(monkeypatch: pytest.MonkeyPatch) -> None:
    spoil(monkeypatch, lambda call: call >= 60)
    trainer, notes = (
        KeyframeTrainer(keyframes.rough_start(), keyframes.gains(), keyframes.CONFIG, max_points=3000),
        Notes(),
    )
    with pytest.raises(ReconstructionError, match=r"even at 0.0625 times its learning rates: .* is nan.*capture check"):
        trainer.train(keyframes.make_images(), TOTAL, TOTAL, notes)
    assert len(notes.notes) == ATTEMPTS


class Value:
    """A training of one number."""

    def __init__(self) -> None:
        self.value, self.kept = 1.0, list[float]()

    def check(self) -> None:
        splat.check_finite(value=np.array(self.value))

    def snapshot(self) -> Callable[[], None]:
        self.kept.append(self.value)
        return self.restore

    def restore(self) -> None:
        self.value = self.kept[-1]


def test_recovery_saves_only_finite_states() -> None:
    training, state, notes = Value(), Recovery(), Notes()
    state.save_state(0, training)
    training.value = np.inf
    with pytest.raises(GaussiansError) as found:
        state.check_iteration(recovery.KEEP_EVERY, 0.1, training)
    assert state.restore(recovery.KEEP_EVERY, found.value, notes) == 0
    assert (training.value, training.kept) == (1.0, [1.0])


def test_trainer_is_freed_without_garbage_collection() -> None:
    """The frames of a group take gigabytes, so they must not wait for the garbage collector."""
    keyframe = KeyframeTrainer(keyframes.rough_start(), keyframes.gains(), keyframes.CONFIG, max_points=3000)
    group = groups.trainer(groups.frames(), groups.config(iterations=2))
    gc.disable()
    try:
        keyframe.train(keyframes.make_images(), 5, 5, Silent())
        group.train(Silent())
        left = [weakref.ref(keyframe), weakref.ref(group)]
        del keyframe, group
        assert [each() for each in left] == [None, None]
    finally:
        gc.enable()
