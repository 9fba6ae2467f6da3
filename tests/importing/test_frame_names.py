"""Order of frames by the numbers in their names."""

import pytest

from splatreel.base.errors import GaussiansError
from splatreel.importing.frame_names import order_frames


@pytest.mark.parametrize(
    "names",
    [
        ["0", "1", "2"],
        ["f9", "f10", "f11"],
        ["frame_0001_splats", "frame_0002_splats"],
        ["v0.1_f3_final2", "v0.1_f4_final2"],
        ["12.0001", "12.0002", "12.0003"],
        ["shot.9", "shot.10"],
        ["f1/point_cloud/iteration_7", "f2/point_cloud/iteration_7"],
        ["0", "9" * 18],
        [f"{'7' * 5000}_1", f"{'7' * 5000}_2"],
        ["frame1_1700000033", "frame2_1700000067", "frame3_1700000100"],
    ],
)
def test_frames_are_ordered_by_the_number_that_differs(names: list[str]) -> None:
    order = order_frames(list(reversed(names)), "film", "refuse")
    assert (order.names, order.fps) == (names, None)
    assert order.step == (1 if "9" * 18 not in names else 10**18 - 1)


@pytest.mark.parametrize(
    ("names", "fps"),
    [
        (["0.000", "0.033", "0.067", "0.100"], 30),
        (["t9.5s", "t10.0s", "t10.5s"], 2),
        (["0.0", "0.25", "0.5", "0.75", "1.0"], 4),
        ([f"{frame / 24:.4f}" for frame in range(48)], 24),
        ([f"{frame * 1001 / 30000:.5f}" for frame in range(200)], 30000 / 1001),
    ],
)
def test_seconds_in_names_give_the_frame_rate(names: list[str], fps: float) -> None:
    order = order_frames(list(reversed(names)), "film", "refuse")
    assert order.names == names
    assert order.fps == pytest.approx(fps)


@pytest.mark.parametrize(("names", "step"), [(["f10", "f15", "f20"], 5), (["0", "33", "67", "100"], 100 / 3)])
def test_numbers_may_go_up_in_larger_steps(names: list[str], step: float) -> None:
    assert order_frames(names, "film", "refuse").step == pytest.approx(step)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["0", "1", "3"], "1 frame is missing, the first after 1: the next one is 3"),
        (["0.0", "0.1", "0.3"], "1 frame is missing, the first after 0.1: the next one is 0.3"),
        (["0", "33", "67", "133"], "1 frame is missing, the first after 67"),
        (["0.0", "0.1", "0.25"], "not evenly spaced: 0.1 and 0.25 are 0.15 s apart"),
        (["c1_f1", "c1_f2", "c2_f1"], "hold 2 numbers that differ between files"),
        (["a1", "a01"], "frame 1 twice"),
        (["a1", "b"], "the name b has no number"),
        (["a1", "a2", "b3"], "files called aN and files called bN"),
        (["f0", "f" + 20 * "9"], "the number 99999999999999999999 in a name has more than 18 digits"),
        (["f0", "f1", "f" + 5000 * "9"], "in a name has more than 18 digits, expected one that counts frames"),
        (["0.1", 400 * "9" + ".2"], "in a name has more than 18 digits"),
        (["f" + 5000 * "9", "f0" + 5000 * "9"], "frame 9999999999999999999999999999999999999999 twice"),
    ],
)
def test_unclear_orders_and_gaps_are_named(names: list[str], said: str) -> None:
    with pytest.raises(GaussiansError) as caught:
        order_frames(names, "film", "refuse")
    assert str(caught.value).startswith("film: ")
    assert said in str(caught.value)


def test_held_frames_repeat_names() -> None:
    assert order_frames(["0.0", "0.1", "0.3"], "film", "hold").names == ["0.0", "0.1", "0.1", "0.3"]
