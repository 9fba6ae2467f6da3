"""Serial and parallel processor time of stages, and the model of more cores."""

import re
from pathlib import Path

import numpy as np
import pytest

from cores import MOST, CoreMeter, Region, Work, measuring
from splatreel.base import threads
from splatreel.run.job import Job


def work(serial: float, *regions: Region) -> Work:
    made = Work(serial)
    for region in regions:
        made.add(region)
    return made


def test_even_ranges_divide_until_the_grain() -> None:
    stage = work(2.0, Region(4, [work(8.0)]))
    assert (stage.serial, stage.parallel) == (2.0, 8.0)
    assert [stage.on(cores) for cores in (1, 2, 4, 8, 16)] == [10.0, 6.0, 4.0, 4.0, 4.0]


def test_items_take_as_long_as_the_longest() -> None:
    stage = work(1.0, Region(0, [work(seconds) for seconds in (1.0, 1.0, 5.0, 1.0)]))
    assert [stage.on(cores) for cores in (1, 2, 8)] == [9.0, 7.0, 6.0]


def test_last_items_divide_their_own_regions() -> None:
    """Two items with 4 s of ranges each: on eight cores each has four."""
    items = [work(1.0, Region(100, [work(4.0)])) for _ in range(2)]
    stage = work(0.0, Region(0, items))
    assert stage.parallel == 10.0
    assert [stage.on(cores) for cores in (1, 2, 8)] == [10.0, 5.0, 2.0]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Replace the clock of threads by a number that functions of a test advance."""
    now = [0.0]
    monkeypatch.setattr("cores.time.thread_time", lambda: now[0])
    return now


def test_meter_separates_serial_from_parallel_time(clock: list[float]) -> None:
    meter = CoreMeter()

    def spend(seconds: float) -> None:
        clock[0] += seconds

    with threads.limited(1), meter.stage("tracking"):
        spend(1)
        meter.run_ranges(lambda first, last: spend(last - first), 6, (), chunks=6)
        meter.run_ranges(lambda first, last: spend(4), 100, (), grain=50)
        with meter.stage("reading"):
            spend(7)
        spend(2)
    tracking, reading = meter.stages["tracking"], meter.stages["reading"]
    assert (tracking.serial, tracking.parallel) == (3, 10)
    assert [tracking.on(cores) for cores in (1, 2, 8)] == [13, 3 + 3 + 2, 3 + 1 + 2]
    assert (reading.serial, reading.parallel) == (7, 0)
    assert len(tracking.regions) == MOST + 1


def test_table_of_stages(tmp_path: Path) -> None:
    path = tmp_path / "cores.md"

    def busy(number: int) -> float:
        return float(np.linalg.norm(np.arange(200_000.0)) + number)

    before = threads.run_ranges, Job.timed
    with measuring(path) as meter, meter.stage("tracking"), threads.limited(2):
        found = threads.map_parallel(busy, range(8))
    assert found == [busy(number) for number in range(8)]
    assert (threads.run_ranges, Job.timed) == before
    assert meter.stages["tracking"].parallel > 0
    assert re.search(r"^\| tracking \| \d", path.read_text(), re.MULTILINE)
    assert "| stage | serial, s | parallel, s | 1 core, s | 2 cores, s | 8 cores, s | 16 cores, s |" in path.read_text()
