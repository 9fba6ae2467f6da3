from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from splatreel.evaluation import bench, steps
from splatreel.evaluation.bench import bench_codec, bench_kernels, cloud, front_camera, median_ms
from splatreel.evaluation.steps import step_rows
from splatreel.kernels.image import render_image


def test_the_cloud_fills_the_picture() -> None:
    image = render_image(cloud(2000), front_camera(64, 48))
    lit = image.max(-1) > 0.02
    assert lit.mean() > 0.5


def test_rows_state_what_was_measured() -> None:
    rows = bench_kernels(points=50, width=32, height=24, repeats=1)
    assert [row["what"] for row in rows] == ["render_image", "keyframe step", "group step"]
    assert all(float(rows[k][ratio]) > 0 for k, ratio in ((1, "one_thread"), (2, "undivided")))
    assert all(isinstance(row["ms"], float) and row["ms"] > 0 for row in rows)
    rows = bench_codec(points=40, frames=3, repeats=1)
    assert [row["what"] for row in rows] == ["encode a group", "decode a group"] * 2
    assert [row["codec"] for row in rows] == ["predictive"] * 2 + ["h265"] * 2
    assert all(isinstance(row["bytes"], int) and row["bytes"] > 40 for row in rows)


def test_ratios_are_of_what_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "medians", lambda works, repeats: [2.0, 7.0])
    keyframe, group = step_rows(cloud(40), front_camera(32, 24), 1)
    assert (keyframe["ms"], keyframe["one_thread"]) == (2.0, 3.5)
    assert (group["ms"], group["undivided"], group["points"], group["still"]) == (2.0, 3.5, 10, 30)


def test_the_median_of_times_is_in_milliseconds(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, measure in ((bench, median_ms), (steps, lambda work, repeats: steps.medians([work], repeats)[0])):
        clock = SimpleNamespace(now=0.0)
        clock.perf_counter = lambda clock=clock: clock.now
        monkeypatch.setattr(module, "time", clock)
        seconds = iter([9.0, 0.010, 0.030, 0.023])  # the first call may compile

        def work(clock: SimpleNamespace = clock, seconds: Iterator[float] = seconds) -> None:
            clock.now += next(seconds)

        assert measure(work, 3) == pytest.approx(23), module


def test_the_first_call_is_not_counted() -> None:
    calls: list[int] = []
    assert median_ms(lambda: calls.append(1), 3) >= 0
    assert len(calls) == 4
    assert np.isfinite(median_ms(lambda: None, 1))
