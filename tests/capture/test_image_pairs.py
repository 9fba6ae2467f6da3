"""Images of different cameras are paired by the numbers in their names."""

from pathlib import Path

import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.image_pairs import pair_images

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
