"""The clock of the local viewer."""

import pytest

from splatreel.play.clock import Clock


def test_runs_at_its_rate_and_loops() -> None:
    clock = Clock(2.0, rate=0.5)
    clock.advance(1.0)
    assert clock.time == pytest.approx(0.5)
    clock.advance(4.0)
    assert (clock.time, clock.playing) == (pytest.approx(0.5), True)


def test_ends_without_loop_and_begins_again() -> None:
    clock = Clock(2.0, loop=False)
    clock.advance(5.0)
    assert (clock.time, clock.playing) == (2.0, False)
    clock.advance(1.0)
    assert clock.time == 2.0
    clock.toggle()
    assert (clock.time, clock.playing) == (0.0, True)


def test_seeks_within_the_reel_and_stands_still_when_paused() -> None:
    clock = Clock(2.0)
    clock.seek(9.0)
    assert clock.time == 2.0
    clock.seek(-1.0)
    assert clock.time == 0.0
    clock.toggle()
    clock.advance(1.0)
    assert (clock.time, clock.playing) == (0.0, False)


def test_an_empty_reel_stays_at_its_beginning() -> None:
    clock = Clock(0.0)
    clock.advance(1.0)
    assert clock.time == 0.0
