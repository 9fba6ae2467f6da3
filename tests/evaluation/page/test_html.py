"""HTML of pages: charts."""

import re
import xml.etree.ElementTree as ElementTree
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatreel.evaluation.page.html import HEIGHT, WIDTH, line_chart, number, ticks


def test_a_chart_draws_each_line_within_its_frame() -> None:
    text = line_chart({"a<b": [(0, 1), (10, 3)], "second": [(5, 2)], "empty": []}, "frame", "dB", [5])
    svg, keys = ElementTree.fromstring(f"<div>{text}</div>")
    assert "a<b: 1 to 3, at the end 3" in svg.attrib["aria-label"]
    lines = [e for e in svg if e.tag == "polyline"]
    assert len(lines) == 2
    places = [tuple(map(float, p.split(","))) for line in lines for p in line.attrib["points"].split()]
    assert all(0 < x < WIDTH and 0 < y < HEIGHT for x, y in places)
    assert places[0][0] < places[1][0]
    assert places[0][1] > places[1][1]  # larger values are higher up
    assert [key.text for key in keys] == ["a<b", "second"]
    assert len(re.findall('class="border"', text)) == 1


def test_a_given_range_has_its_first_number_and_not_its_last() -> None:
    text = line_chart({"loss": [(1.02, 0.5), (2, 0.3), (3, 0.1)]}, "group", "loss", x_range=(1, 3))
    assert re.findall('text-anchor="middle">([^<]+)<', text) == ["1", "2"]


def test_a_single_line_needs_no_keys() -> None:
    assert "keys" not in line_chart({"PSNR": [(3, 30.0)]}, "frame", "dB")


def test_a_chart_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="nothing to draw"):
        line_chart({"a": []}, "x", "y")


@given(st.floats(-1e6, 1e6), st.floats(0, 1e6))
def test_ticks_enclose_the_range_in_few_even_steps(low: float, size: float) -> None:
    found = ticks(low, low + size)
    assert found[0] <= low + 1e-6 * (1 + abs(low))
    assert found[-1] >= low + size - 1e-6 * (1 + abs(low) + size)
    assert 2 <= len(found) <= 8
    steps = [b - a for a, b in pairwise(found)]
    assert max(steps) == pytest.approx(min(steps), rel=1e-6)


def test_numbers_are_short() -> None:
    assert [number(v) for v in (0, 0.02134, 31.27, 12345.6, -0.5)] == ["0", "0.0213", "31.3", "12,346", "-0.5"]
