"""Median wall times."""

from types import SimpleNamespace

import pytest

from bench import timing
from bench.timing import median_ms, medians_ms


def test_median_ms_is_in_milliseconds(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now=0.0)
    clock.perf_counter = lambda: clock.now
    monkeypatch.setattr(timing, "time", clock)
    seconds = iter([9.0, 0.010, 0.030, 0.023])  # the first call may compile

    def work() -> None:
        clock.now += next(seconds)

    assert median_ms(work, 3) == pytest.approx(23)


def test_medians_ms_alternates_calls_and_skips_the_first() -> None:
    calls: list[str] = []
    assert len(medians_ms([lambda: calls.append("a"), lambda: calls.append("b")], 2)) == 2
    assert calls == ["a", "b"] * 3
