"""Charts of measurements as SVG files, drawn by matplotlib."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

from splatreel.base.command_line import install_command
from splatreel.base.errors import MissingDependencyError

Series = Mapping[str, Sequence[tuple[float, float]]]
"""Pairs (x, y) of each line, by its name."""


def rate_chart(series: Series, title: str) -> str:
    """Return an SVG chart of (bytes, PSNR in dB) pairs, one line per series, with a logarithmic axis of bytes.

    Raises:
        MissingDependencyError: matplotlib is not installed.
        ValueError: There are no points.
    """
    megabytes = {name: [(size / 1e6, quality) for size, quality in points] for name, points in series.items()}
    return line_chart(megabytes, title, "megabytes", "PSNR, dB", x_scale="log")


def line_chart(series: Series, title: str, x_label: str, y_label: str, x_scale: str = "linear") -> str:
    """Return an SVG chart with one line per series.

    Args:
        series: Pairs of each line.
        title: Title.
        x_label: Label of the horizontal axis.
        y_label: Label of the vertical axis.
        x_scale: linear or log.

    Raises:
        MissingDependencyError: matplotlib is not installed.
        ValueError: There are no points.
    """
    try:
        from matplotlib.figure import Figure  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingDependencyError(f"Charts need matplotlib. Run\n  {install_command('plots')}") from error
    if not any(series.values()):
        raise ValueError("there is nothing to draw")
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    for name, points in series.items():
        xs, ys = zip(*sorted(points), strict=True) if points else ((), ())
        axes.plot(xs, ys, marker="o", label=name)
    axes.set(title=title, xlabel=x_label, ylabel=y_label, xscale=x_scale)
    axes.grid(alpha=0.3)
    axes.legend()
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
