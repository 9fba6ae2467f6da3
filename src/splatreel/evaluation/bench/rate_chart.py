"""Chart of bytes against quality, drawn by matplotlib."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

from splatreel.errors import MissingDependencyError


def rate_chart(series: Mapping[str, Sequence[tuple[float, float]]], title: str) -> str:
    """Return an SVG chart of (bytes, PSNR in dB) pairs, one line per series, with a logarithmic axis of bytes.

    Raises:
        MissingDependencyError: matplotlib is not installed.
        ValueError: There are no points.
    """
    try:
        from matplotlib.figure import Figure  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingDependencyError("Charts need matplotlib. Run\n  pip install 'splatreel[plots]'") from error
    if not any(series.values()):
        raise ValueError("there is nothing to draw")
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    for name, points in series.items():
        sizes, qualities = zip(*sorted(points), strict=True) if points else ((), ())
        axes.plot([size / 1e6 for size in sizes], qualities, marker="o", label=name)
    axes.set(title=title, xlabel="megabytes", ylabel="PSNR, dB", xscale="log")
    axes.grid(alpha=0.3)
    axes.legend()
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
