"""Time of a long video on several machines, by the model of the estimate."""

import pytest

from chapters import run_time


def test_scene_and_finish_limit_the_speedup() -> None:
    parts = {"scene": 60.0, "chapter": 1000.0, "finish": 5.0, "chapters": 20}
    times = [run_time(**parts, cores=cores, machines=machines) for cores, machines in ((1, 1), (16, 1), (16, 8))]
    assert times[0] == pytest.approx(20065)
    assert times[0] / 16 < times[1] < times[0] / 6
    assert times[2] < times[1] / 4
