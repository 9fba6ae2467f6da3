"""The clock of the local viewer."""

import pytest

from splatreel.play.clock import Clock


def test_clock_advances_at_its_rate_and_loops() -> None:
    clock = Clock(2.0, rate=0.5)
    clock.advance(1.0)
    assert clock.time == pytest.approx(0.5)
    clock.advance(4.0)
    assert (clock.time, clock.playing) == (pytest.approx(0.5), True)


def test_clock_stops_at_end_and_restarts() -> None:
    clock = Clock(2.0, loop=False)
    clock.advance(5.0)
    assert (clock.time, clock.playing) == (2.0, False)
    clock.advance(1.0)
    assert clock.time == 2.0
    clock.toggle()
    assert (clock.time, clock.playing) == (0.0, True)


def test_clock_clamps_seeks_and_stops_when_paused() -> None:
    clock = Clock(2.0)
    clock.seek(9.0)
    assert clock.time == 2.0
    clock.seek(-1.0)
    assert clock.time == 0.0
    clock.toggle()
    clock.advance(1.0)
    assert (clock.time, clock.playing) == (0.0, False)


def test_clock_of_empty_reel_stays_at_start() -> None:
    clock = Clock(0.0)
    clock.advance(1.0)
    assert clock.time == 0.0
