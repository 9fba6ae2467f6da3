"""Charts with two logarithmic axes, in a grid, as a handwritten SVG."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

COLORS = ("#1b6ca8", "#c0392b", "#2e8b57", "#8e44ad", "#b8860b", "#555555")

WIDTH, HEIGHT = 190, 170
"""Of one chart without its labels, pixels."""
LEFT, TOP, BETWEEN, BELOW = 62, 44, 26, 50
"""Room beside the first chart, above each, between two, below each."""
EMPTY = 0.06
"""Share of a chart that is left free on each side."""


@dataclass(frozen=True)
class Panel:
    """A chart. points: (x, y), both greater than 0, in the order of x. labels: what stands below each.

    title: what x is. note: stands above the chart.
    """

    title: str
    points: Sequence[tuple[float, float]]
    labels: Sequence[str]
    note: str = ""


def charts(lines: Sequence[tuple[str, Sequence[Panel]]]) -> str:
    """Return an SVG of rows of charts. The charts of a row share the scale of y.

    Raises:
        ValueError: There is no point.
    """
    across = max(len(panels) for _, panels in lines)
    wide, high = LEFT + across * (WIDTH + BETWEEN), len(lines) * (TOP + HEIGHT + BELOW)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" font-family="sans-serif" font-size="12">',
        f'<rect width="{wide}" height="{high}" fill="white"/>',
    ]
    for number, (title, panels) in enumerate(lines):
        top = TOP + number * (TOP + HEIGHT + BELOW)
        values = [y for panel in panels for _, y in panel.points]
        if not values:
            raise ValueError("there is nothing to draw")
        scale = Scale(values, top + HEIGHT, -HEIGHT)
        parts.append(f'<text x="8" y="{top - 26}" font-size="14">{escape(title)}</text>')
        color = COLORS[number % len(COLORS)]
        for place, panel in enumerate(panels):
            parts += _chart(panel, scale, LEFT + place * (WIDTH + BETWEEN), top, color, first=place == 0)
    return "\n".join([*parts, "</svg>"]) + "\n"


class Scale:
    """Positions of numbers on a logarithmic axis. begin: pixel of its lower end. length: pixels, negative upwards."""

    def __init__(self, values: Sequence[float], begin: float, length: float) -> None:
        low, high = math.log10(min(values)), math.log10(max(values))
        free = max(EMPTY * (high - low), 0.02)
        self.low = low - free
        self.high = high + free
        self._begin = begin
        self._length = length

    def place(self, value: float) -> float:
        return self._begin + self._length * (math.log10(value) - self.low) / (self.high - self.low)

    def ticks(self) -> list[float]:
        """Return round numbers on the axis: 1, 2 and 5 times powers of ten; only powers on a long axis."""
        steps = (1,) if self.high - self.low > 3 else (1, 2, 5)
        decades = range(math.floor(self.low), math.ceil(self.high) + 1)
        numbers = [step * 10.0**decade for decade in decades for step in steps]
        return [number for number in numbers if self.low <= math.log10(number) <= self.high]


def _chart(panel: Panel, scale: Scale, left: int, top: int, color: str, first: bool) -> list[str]:
    """Return the elements of a chart.

    Args:
        first: The chart has the numbers of y beside it.
    """
    parts = [f'<path d="M{left} {top}V{top + HEIGHT}H{left + WIDTH}" stroke="#999" fill="none"/>']
    for value in scale.ticks():
        y = scale.place(value)
        parts.append(f'<path d="M{left} {y:.1f}h{WIDTH}" stroke="#ddd"/>')
        if first:
            parts.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{value:,g}</text>')
    middle = left + WIDTH / 2
    parts.append(f'<text x="{middle:.1f}" y="{top + HEIGHT + 34}" text-anchor="middle">{escape(panel.title)}</text>')
    parts.append(
        f'<text x="{middle:.1f}" y="{top - 8}" text-anchor="middle" fill="{color}">{escape(panel.note)}</text>'
    )
    if not panel.points:
        return parts
    across = Scale([x for x, _ in panel.points], left, WIDTH)
    places = [(across.place(x), scale.place(y)) for x, y in panel.points]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    parts.append(f'<polyline points="{line}" fill="none" stroke="{color}" stroke-width="2"/>')
    for (x, y), label in zip(places, panel.labels, strict=True):
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{color}"/>')
        parts.append(f'<text x="{x:.1f}" y="{top + HEIGHT + 16}" text-anchor="middle">{escape(label)}</text>')
    return parts
