"""Missing frames: what stands in for them, and their description."""

import numpy as np

from splatreel.capture.gaps import describe_gaps, nearest, used_steps


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
