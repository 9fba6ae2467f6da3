"""Images whose names hold times, or several numbers."""

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.image_times import Keys, moments

RNG = np.random.default_rng(0)


def of(names: list[list[str]], notes: list[str] | None = None) -> Keys:
    found = moments("scene", {f"cam{number}": own for number, own in enumerate(names)}, [] if notes is None else notes)
    assert found is not None
    return found


def is_in_step(keys: Keys) -> bool:
    """Return whether images with the same index, and no others, have the same key, in ascending order."""
    first, *others = keys.values()
    return sorted(set(first)) == first and all(first == other for other in others)


@pytest.mark.parametrize("unit", [1e3, 1e9])
def test_times_of_a_moment_differ_between_cameras(unit: float) -> None:
    times = [unit * (1_700_000_000 + step / 30) for step in range(40)]
    names = [[f"{round(time + RNG.uniform(-1, 1) * 0.002 * unit)}" for time in times] for _ in range(5)]
    notes: list[str] = []
    assert is_in_step(of(names, notes))
    assert len(notes) == 1
    assert "differ by up to" in notes[0]


@pytest.mark.parametrize("shift", [0.3, 0.5, 0.7])
def test_times_between_moments_are_not_merged(shift: float) -> None:
    late = [[f"{round(100 * (step + shift * at))}" for step in range(20)] for at in (0, 0, 1)]
    found = of(late)
    assert not set(found["cam2"]) & set(found["cam0"])


def test_times_that_run_together_are_refused() -> None:
    names = [[f"{100 * step + 20 * at}" for step in range(20)] for at in range(4)]
    with pytest.raises(CaptureError, match="not clear which images belong together"):
        of(names)


@pytest.mark.parametrize("rate", [4, 10, 30, 50])
def test_seconds_need_no_trailing_zeros(rate: int) -> None:
    names = [f"t{round(step / rate, 3)}" for step in range(3 * rate)]
    assert is_in_step(of([names] * 3))
    assert is_in_step(of([names[1:rate]] * 3)), "within one second"


def test_numbers_behind_points_are_counted() -> None:
    names = [f"take{take}.{step}" for take in (1, 2) for step in range(1, 13)]
    assert is_in_step(of([names] * 3))
    assert is_in_step(of([names[:12]] * 3))


def test_a_time_beside_the_number_of_the_frame_does_not_count() -> None:
    names = [[f"f{step}_{33 * step + RNG.integers(0, 2)}" for step in range(20)] for _ in range(3)]
    assert is_in_step(of(names))


def test_numbers_that_only_together_give_the_order() -> None:
    names = [f"{hour:02}-{minute:02}" for hour in (9, 10) for minute in (0, 20, 40)]
    assert is_in_step(of([names] * 3))


def test_names_without_numbers_are_not_compared() -> None:
    assert moments("scene", {"a": ["x", "y"], "b": ["x", "y"]}, []) is None
