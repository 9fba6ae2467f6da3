"""Bytes against quality as a drawing: an SVG written by hand, which every browser shows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

WIDTH, HEIGHT, LEFT, BELOW = 720, 440, 64, 48
COLORS = ("#1b6ca8", "#c0392b", "#2e8b57", "#8e44ad", "#b8860b", "#555555")


def rate_chart(series: Mapping[str, Sequence[tuple[float, float]]], title: str) -> str:
    """An SVG of series of (bytes, PSNR in dB), each joined by a line in the order of its bytes; bytes on a logarithmic axis."""
    points = [point for values in series.values() for point in values]
    if not points:
        raise ValueError("there is nothing to draw")
    low, high = (math.log10(f(size for size, _ in points)) for f in (min, max))
    bottom, top = (f(quality for _, quality in points) for f in (min, max))
    low, high = low - 0.05 * (high - low + 0.1), high + 0.05 * (high - low + 0.1)
    bottom, top = bottom - 0.05 * (top - bottom + 0.02), top + 0.05 * (top - bottom + 0.02)

    def place(size: float, quality: float) -> tuple[float, float]:
        x = LEFT + (math.log10(size) - low) / (high - low) * (WIDTH - LEFT - 16)
        return x, 40 + (top - quality) / (top - bottom) * (HEIGHT - 40 - BELOW)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="12">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/><text x="{LEFT}" y="22" font-size="15">{escape(title)}</text>',
        f'<text x="{WIDTH - 16}" y="{HEIGHT - 10}" text-anchor="end">megabytes</text><text x="8" y="36">PSNR, dB</text>',
    ]
    for size in _ticks_of_bytes(low, high):
        x, _ = place(size, top)
        parts.append(f'<path d="M{x:.1f} 40V{HEIGHT - BELOW}" stroke="#ddd"/>')
        parts.append(f'<text x="{x:.1f}" y="{HEIGHT - BELOW + 16}" text-anchor="middle">{size / 1e6:g}</text>')
    for quality in _ticks(bottom, top):
        _, y = place(10**low, quality)
        parts.append(f'<path d="M{LEFT} {y:.1f}H{WIDTH - 16}" stroke="#ddd"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{quality:g}</text>')
    for index, (name, values) in enumerate(series.items()):
        color = COLORS[index % len(COLORS)]
        places = [place(*point) for point in sorted(values)]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{color}" stroke-width="2"/>')
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{color}"/>' for x, y in places]
        parts.append(
            f'<text x="{WIDTH - 20}" y="{HEIGHT - BELOW - 12 - 16 * index}" text-anchor="end" fill="{color}">{escape(name)}</text>'
        )
    return "\n".join([*parts, "</svg>"]) + "\n"


def _ticks(low: float, high: float) -> list[float]:
    """Four to ten round numbers between low and high."""
    step = 10 ** math.floor(math.log10((high - low) / 4))
    step *= next(factor for factor in (5, 2, 1) if (high - low) / (step * factor) >= 3)
    return [round(index * step, 9) for index in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _ticks_of_bytes(low: float, high: float) -> list[float]:
    sizes = [m * 10.0**e for e in range(math.floor(low), math.ceil(high) + 1) for m in (1, 2, 3, 5, 7)]
    return [size for size in sizes if low <= math.log10(size) <= high]
