"""`splatreel bench`: how fast the parts are on this machine."""

from __future__ import annotations

import json as json_format

from tyro.extras import SubcommandApp


def kernels(points: int = 20_000, width: int = 320, height: int = 240, repeats: int = 20, json: bool = False) -> None:
    """Time rendering and one training step.

    Args:
        points: Gaussians in the picture.
        width: Width of the picture in pixels.
        height: Height of the picture in pixels.
        repeats: How often; the median counts.
        json: Print one JSON object a line.
    """
    from splatreel.evaluation.bench import bench_kernels

    show(bench_kernels(points, width, height, repeats), json)


def codec(points: int = 10_000, frames: int = 35, repeats: int = 3, json: bool = False) -> None:
    """Time encoding and decoding a group.

    Args:
        points: Dynamic points of the group.
        frames: Frames of the group.
        repeats: How often; the median counts.
        json: Print one JSON object a line.
    """
    from splatreel.evaluation.bench import bench_codec

    show(bench_codec(points, frames, repeats), json)


def show(rows: list[dict[str, float | int | str]], json: bool) -> None:
    """Print measurements, one a line."""
    for row in rows:
        if json:
            print(json_format.dumps(row))
        else:
            rest = ", ".join(f"{name} {value:,}" for name, value in row.items() if name not in ("what", "ms"))
            print(f"{row['what']:<16} {row['ms']:>10,.1f} ms   {rest}")


def build() -> SubcommandApp:
    """The kinds of measurement."""
    app = SubcommandApp()
    app.__doc__ = "Measure how fast the parts are on this machine."
    app.command(kernels)
    app.command(codec)
    return app
