"""Figures 7, 8, 9, 11 and 12: crops of held-out views, truth beside render, chosen by error."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from paper_tables.image_crops import (
    Crop,
    Render,
    Weight,
    anywhere,
    fast,
    find_crop,
    new,
    renderer,
    strip,
    truth_of,
)
from paper_tables.paper_bench import FULL, INDEPENDENT, PER_FRAME, STREAMING, VIDEO, PaperBench
from paper_tables.paper_comparisons import name_of
from paper_tables.paper_tables import TABLE_9, TABLE_10, write_first_frame
from splatreel.config import EncodeConfig
from splatreel.evaluation.comparison_images import layers_overlay, write_png
from splatreel.evaluation.report import write_text
from splatreel.play.timeline import open_reel
from splatreel.run.output.reencode import reencode

METHODS_SHOWN = (FULL, PER_FRAME, STREAMING, VIDEO, INDEPENDENT)
PROGRESSIVE = (FULL, "w/o Prg.")


@dataclass(frozen=True)
class PaperImage:
    """A figure of the paper that is an image.

    Attributes:
        title: Content.
        variants: Variants that it needs.
        draw: Function that returns the rows of a capture: a caption and crops by name.
    """

    title: str
    variants: Sequence[str]
    draw: Callable[[PaperBench, str], list[Row]]


@dataclass(frozen=True)
class Row:
    """A row of a figure.

    Attributes:
        caption: Capture, camera, frame and place.
        crops: Images by name, the truth first.
    """

    caption: str
    crops: Mapping[str, np.ndarray]


def write_figure(bench: PaperBench, number: str) -> str:
    """Draw a figure, write OUT/NUMBER.png and .md, and return the Markdown text. The image has a row for each caption."""
    figure = IMAGES[number]
    rows = [row for name in bench.captures for row in figure.draw(bench, name)]
    lines = [f"Figure {number.removeprefix('figure')}, {figure.title}. Held-out cameras.", ""]
    if rows:
        strips = [strip(row.crops) for row in rows]
        widest = max(part.shape[1] for part in strips)
        padded = [np.pad(s, ((0, 0), (0, widest - s.shape[1]), (0, 0)), constant_values=255) for s in strips]
        write_png(bench.out / f"{number}.png", np.concatenate(padded))
        lines += [f"![{figure.title}]({number}.png)", ""]
    lines += [f"- {row.caption}: {', '.join(row.crops)}." for row in rows] or ["No capture shows this."]
    text = "\n".join(lines) + "\n"
    write_text(bench.out / f"{number}.md", text)
    return text


def compared(variants: Sequence[str], weight: Weight, why: str) -> Callable[[PaperBench, str], list[Row]]:
    """Return the function that compares variants where their weighted error is largest.

    Args:
        variants: Variants to compare.
        weight: Weight of the error of each pixel.
        why: Reason for the place of the crop.
    """

    def draw(bench: PaperBench, name: str) -> list[Row]:
        reels = {name_of(v): renderer(open_reel(bench.measure(name, v).run / "reel")) for v in variants}
        crop = find_crop(bench.captures[name], list(reels.values()), weight)
        return [] if crop is None else [_row(bench, name, crop, reels, why)]

    return draw


def compressed(bench: PaperBench, name: str) -> list[Row]:
    """Return the rows of Figure 11: point quantization of Table 9 at the first frame, and motion coding of Table 10."""
    run = bench.measure(name, FULL).run
    with tempfile.TemporaryDirectory(prefix="splatreel-figure-") as folder:

        def reel(number: int, config: EncodeConfig, first: bool) -> Render:
            place = Path(folder) / f"{'first' if first else 'all'}{number}"
            if first:
                write_first_frame(run, place, config)
            else:
                reencode(run / "work", place, config, bench.progress)
            return renderer(open_reel(place))

        nine = {f"#{n} {' '.join(key)}": reel(n, config, True) for n, (key, config) in enumerate(TABLE_9.items(), 1)}
        ten = {f"#{n} {' '.join(key)}": reel(n, config, False) for n, (key, config) in enumerate(TABLE_10.items(), 1)}
        rows = []
        for renders, frames, why in ((nine, [0], "Table 9"), (ten, None, "Table 10")):
            uncompressed, *others = renders.values()
            crop = find_crop(bench.captures[name], others, anywhere, frames, uncompressed)
            if crop is not None:
                rows.append(_row(bench, name, crop, renders, f"largest loss by the configurations of {why}"))
        return rows


def failures(bench: PaperBench, name: str) -> list[Row]:
    """Return the row of Figure 12: the largest error of moving pixels, with the layers of the moment."""
    timeline = open_reel(bench.measure(name, FULL).run / "reel")
    capture, render = bench.captures[name], renderer(timeline)
    crop = find_crop(capture, [render], fast)
    if crop is None:
        return []
    view, moment = capture.camera(crop.camera), timeline.at(crop.frame / timeline.fps)
    image = render(crop.frame, view)
    row = _row(bench, name, crop, {"Ours": lambda *_: image}, "largest error of moving pixels")
    layers = crop.of(layers_overlay(timeline, moment, view, image))
    return [Row(row.caption, {**row.crops, "layers (blue: dynamic)": layers})]


def _row(bench: PaperBench, name: str, crop: Crop, renders: Mapping[str, Render], why: str) -> Row:
    """Return the truth and the renders of a crop."""
    capture = bench.captures[name]
    view = capture.camera(crop.camera)
    crops = {"truth": crop.of(truth_of(capture, crop.frame, crop.camera))}
    crops |= {label: crop.of(render(crop.frame, view)) for label, render in renders.items()}
    return Row(f"{name}, {crop.camera}, frame {crop.frame}, at ({crop.left}, {crop.top}), {why}", crops)


IMAGES: dict[str, PaperImage] = {
    "figure7": PaperImage("fast motion", METHODS_SHOWN, compared(METHODS_SHOWN, fast, "largest error of fast motion")),
    "figure8": PaperImage(
        "newly appeared objects", METHODS_SHOWN, compared(METHODS_SHOWN, new, "largest error of new content")
    ),
    "figure9": PaperImage(
        "progressive frame sampling", PROGRESSIVE, compared(PROGRESSIVE, fast, "largest error of fast motion")
    ),
    "figure11": PaperImage("compression", (FULL,), compressed),
    "figure12": PaperImage("a failure, with its layers", (FULL,), failures),
}
"""Images by the value of --table."""
