import io
import re
import time

import pytest

from splatreel.base.display import Lines, Terminal, console
from splatreel.base.progress import Estimate, Silent, format_numbers, format_rounded, format_seconds


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_lines_print_one_line_per_stage() -> None:
    clock, stream = Clock(), io.StringIO()
    lines = Lines(stream, clock=clock)
    lines.stage("building", 100)
    for done in range(1, 101):
        clock.now += 0.25
        lines.update(done, psnr=28.5, points=12_000)
        lines.beat()
    lines.update(100, points=12_000)
    lines.note("written")
    lines.stage("reading", 3)
    lines.update(1)
    clock.now += 2
    lines.stage("writing", 1, (0.5, 0.75))  # the stage before ended without a report
    clock.now += 20
    lines.update(1, points=7)
    lines.close()
    assert stream.getvalue().splitlines() == [
        "building: done in 25 s, 28.5 dB, 12,000 points",
        "written",
        "reading: done in 2.0 s",
        "writing: done in 20 s, 7 points, about 20 s left in all",
    ]


def test_estimate_covers_the_whole_job_with_spans() -> None:
    clock = Clock()
    estimate = Estimate(clock)
    estimate.stage(10, (0.5, 0.75))  # continued: half of the job was done before
    assert estimate.seconds_left() is None
    clock.now += 20
    estimate.done = 5
    assert estimate.seconds_left() == pytest.approx(60)
    clock.now += 20
    estimate.stage(10, (0.75, 1.0))
    assert estimate.seconds_left() == pytest.approx(40)


def test_estimate_of_a_whole_job_waits_for_enough_of_it() -> None:
    clock = Clock()
    estimate = Estimate(clock)
    estimate.stage(10, (0.0, 0.2))
    clock.now += 30  # most of it for kernels to compile
    estimate.done = 2
    assert estimate.seconds_left() is None
    estimate.done = 3
    assert estimate.seconds_left() == pytest.approx(30 * 0.94 / 0.06)
    estimate.done = 2
    clock.now += 30
    assert estimate.seconds_left() == pytest.approx(60 * 0.96 / 0.04)


def test_estimate_ignores_stages_without_span() -> None:
    clock = Clock()
    estimate = Estimate(clock)
    estimate.stage(1, (0.0, 0.1))
    clock.now += 2
    estimate.done = 1
    estimate.stage(1, None)  # a check that takes long, once
    clock.now += 100
    estimate.stage(10, (0.1, 1.0))
    assert estimate.seconds_left() == pytest.approx(18)


def test_stage_without_steps() -> None:
    stream = io.StringIO()
    lines = Lines(stream, clock=Clock())
    lines.stage("nothing", 0)
    lines.update(0)
    assert stream.getvalue().splitlines()[-1] == "nothing: done in 0.0 s"


def test_terminal_shows_bars() -> None:
    class Tty(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Tty()
    display = console(stream)
    assert isinstance(display, Terminal)
    display.stage("keyframe [1]", 10)
    display.update(10, psnr=30.0)
    display.note("a [note]")
    display.close()
    assert "a [note]" in stream.getvalue()
    assert "100 %" in stream.getvalue()
    assert "done in 0.0 s" in stream.getvalue()
    assert isinstance(console(io.StringIO()), Lines)


def test_finished_stages_stay_on_the_screen_once() -> None:
    class Tty(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Tty()
    display = Terminal(stream)
    for number in range(60):  # more than a screen has lines
        display.stage(f"stage {number}", 2)
        display.update(1, points=7)
        display.update(2, points=1000 + number)
    display.close()
    shown = stream.getvalue()
    assert all(f"{1000 + number:,} points\n" in re.sub(r" +\n", "\n", shown) for number in range(60))
    assert "..." not in shown, "nothing is cut off for want of lines"
    assert shown.count("1,007 points") <= 2


def test_long_stages_are_reported_as_running() -> None:
    clock, stream = Clock(), io.StringIO()
    lines = Lines(stream, interval=5, clock=clock)
    lines.stage("finding surfaces", 4)
    lines.update(1, points=3)
    lines.beat()
    assert stream.getvalue() == "", "it has just begun"
    clock.now += 6
    lines.beat()
    lines.beat()
    lines.update(4)
    clock.now += 20
    lines.beat()
    lines.close()
    clock.now += 20
    lines.beat()
    assert stream.getvalue().splitlines() == [
        "finding surfaces: 25 %, 6.0 s so far, 3 points, about 18 s left",
        "finding surfaces: done in 6.0 s, 3 points",
        "finding surfaces: done, continuing, 26 s so far, 3 points",
    ]


def test_lines_report_long_stages_from_a_thread() -> None:
    stream = io.StringIO()
    lines = Lines(stream, interval=0.02)
    lines.stage("finding surfaces", 1)
    for _ in range(6000):
        if "so far" in stream.getvalue():
            break
        time.sleep(0.01)
    lines.close()
    assert "finding surfaces: 0 %, " in stream.getvalue()


def test_silent_prints_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    silent = Silent()
    silent.stage("a", 1)
    silent.update(1)
    silent.note("b")
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.44, "0.4 s"), (12, "12 s"), (59.7, "1 min 00 s"), (185, "3 min 05 s"), (7800, "2 h 10 min")],
)
def test_format_seconds_known_answers(seconds: float, text: str) -> None:
    assert format_seconds(seconds) == text


def test_estimates_are_rounded_to_what_is_known() -> None:
    assert [format_rounded(seconds) for seconds in (12.4, 45, 117, 7300)] == ["12 s", "45 s", "2 min", "2 h 02 min"]


def test_format_numbers_known_answers() -> None:
    assert format_numbers({"points": 40_000, "psnr": 29.1267}) == "40,000 points, 29.1 dB"
    assert format_numbers({"moving": 3100, "appeared": 5305}) == "3,100 moving points, 5,305 of them new"
    found = format_numbers({"moving": 412, "static": 3000, "lit": 591})
    assert found == "412 moving points, 3,000 static points, 591 static points in changing light"
    assert format_numbers({"rate": 2.5}) == "rate 2.5"
