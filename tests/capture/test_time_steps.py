""""""

from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.time_steps import Keys, describe_gaps, moments, nearest, pair_images, used_steps


def test_nearest_frame_stands_in_and_the_earlier_of_two() -> None:
    exists = np.array([False, True, False, False, True, False, True, False])
    assert nearest(exists).tolist() == [1, 1, 1, 4, 4, 4, 6, 6]


def test_steps_are_used_as_far_as_most_cameras_have_them() -> None:
    exists = {"a": [1, 1, 1, 1, 1, 1], "b": [0, 1, 0, 0, 1, 0], "c": [0, 1, 0, 0, 0, 0]}
    assert used_steps({name: np.array(row, bool) for name, row in exists.items()}) == (1, 5)


def test_gaps_are_described_in_stretches() -> None:
    missing = {"a": np.zeros(20, bool), "b": np.isin(np.arange(20), [3, 5, 6, 7, 10, 12, 14])}
    assert describe_gaps(missing, range(100, 120), "images") == [
        "b has no images 103, 105-107, 110, 112 and 1 more: left out of training for that camera only"
    ]
    assert describe_gaps({"a": np.zeros(3, bool)}, range(3), "frames") == []


Names = dict[str, list[str]]


def paired(names: Names) -> tuple[dict[str, list[str | None]], list[str]]:
    files = {camera: [Path(camera) / name for name in found] for camera, found in names.items()}
    pairs = pair_images(Path("scene"), files)
    return {camera: [file and file.name for file in found] for camera, found in pairs.files.items()}, pairs.notes


def numbers(*chosen: int, prefix: str = "", digits: int = 0) -> list[str]:
    return [f"{prefix}{number:0{digits}d}.png" for number in chosen]


@pytest.mark.parametrize(
    "other",
    [
        numbers(*range(12)),
        numbers(*range(12), prefix="cam7_frame"),
        numbers(*range(12), digits=5),
        [f"shot12_{number}_left.png" for number in range(12)],
    ],
)
def test_numbers_pair_images_named_in_different_ways(other: list[str]) -> None:
    found, notes = paired({"a": numbers(*range(12)), "b": other[::-1], "c": numbers(*range(12))})
    assert found["a"] == numbers(*range(12))
    assert found["b"] == other
    assert notes == []


@pytest.mark.parametrize("lost", [0, 5, 11])
def test_gap_of_one_camera_keeps_the_frames_of_the_others(lost: int) -> None:
    names: Names = {camera: numbers(*range(12)) for camera in "abcd"}
    names["b"].remove(f"{lost}.png")
    found, _ = paired(names)
    assert found["a"] == numbers(*range(12))
    assert [file is None for file in found["b"]] == [step == lost for step in range(12)]


def test_steps_that_most_cameras_lack_at_the_ends_are_not_used() -> None:
    found, notes = paired({"a": numbers(*range(9)), "b": numbers(2, 3, 4), "c": numbers(3, 4, 5)})
    assert found == {"a": numbers(2, 3, 4, 5), "b": [*numbers(2, 3, 4), None], "c": [None, *numbers(3, 4, 5)]}
    assert "5 time steps at the ends" in notes[-1]


def test_number_that_no_camera_has_is_named() -> None:
    names = numbers(0, 10, 20, 50, 60)
    _, notes = paired({"a": names, "b": names, "c": names})
    assert notes == ["no camera has images between 20 and 50: the video jumps there"]


def test_stray_image_is_skipped_and_named() -> None:
    found, notes = paired(
        {"a": [*numbers(0, 1, 2, 3), "preview.png"], "b": numbers(0, 1, 2, 3), "c": numbers(0, 1, 2, 3)}
    )
    assert found["a"] == numbers(0, 1, 2, 3)
    assert "preview.png" in notes[0]


def test_one_image_each_needs_no_number() -> None:
    found, notes = paired({"a": ["cam3.png"], "b": ["cam7.png"], "c": ["x.png"]})
    assert (found, notes) == ({"a": ["cam3.png"], "b": ["cam7.png"], "c": ["x.png"]}, [])


def test_numbers_without_anything_in_common_are_paired_in_order() -> None:
    found, notes = paired({"a": numbers(1, 2), "b": numbers(101, 102), "c": numbers(501, 502)})
    assert found["b"] == numbers(101, 102)
    assert "paired in their order" in notes[0]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"a": numbers(1, 2), "b": numbers(11, 12), "c": numbers(21, 22, 23)}, "a has 2, .* c has 3"),
        ({"a": ["1.png", "01.png"], "b": numbers(1, 2)}, "1.png and 01.png are of the same time step"),
        ({"a": ["1.jpg", "1.png", "2.png"], "b": numbers(1, 2)}, "1.jpg and 1.png are of the same time step"),
        ({"a": ["0.png", "mask0.png", "1.png", "mask1.png"], "b": numbers(0, 1)}, "images of several kinds"),
    ],
)
def test_ambiguous_images_are_refused(names: Names, message: str) -> None:
    with pytest.raises(CaptureError, match=message):
        paired(names)


@pytest.mark.parametrize(("shift", "said"), [(500, "no number of c in common"), (16, "59 different numbers")])
def test_numbers_with_little_in_common_are_refused(shift: int, said: str) -> None:
    names: Names = {camera: numbers(*range(0, 990, 33)) for camera in "ab"}
    names["c"] = numbers(*(33 * step + shift * (1 if shift < 33 else 1000) for step in range(30)))
    with pytest.raises(CaptureError, match=said):
        paired(names)


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
