"""Tables 1, 2, 3 and 5, Figure 15, and the baselines: ours beside other methods, measured or as the paper prints them."""

from __future__ import annotations

from statistics import fmean

from paper_tables.paper_bench import (
    BASELINES,
    FULL,
    INDEPENDENT,
    NO_LAYERS,
    PER_FRAME,
    SLICES,
    STREAMING,
    VIDEO,
    PaperBench,
)
from paper_tables.paper_results import PaperResult, means
from paper_tables.paper_table import PaperTable
from paper_tables.published import (
    TABLE_1,
    TABLE_2,
    TABLE_3,
    TABLE_5,
    comparable,
    has_own,
    published_rows,
)
from splatreel.codec.reader import ReelReader

MEASURED = "measured"
ALL = (*BASELINES, NO_LAYERS, FULL)
OTHERS = (INDEPENDENT, SLICES, STREAMING, VIDEO, FULL)
"""Variants that stand for methods of Table 1."""
LONG = (PER_FRAME, FULL)
TIMES = (
    " Independent groups and all points moving train as many iterations as ours, whatever time that takes. All other baselines "
    "train as long as ours, if no --minutes are given."
)


def baselines(bench: PaperBench) -> PaperTable:
    """Return our method beside all baselines."""
    frames = fmean(capture.frames for capture in bench.captures.values())
    rows = []
    for variant in ALL:
        m = means(bench, variant)
        kilobytes = f"{1000 * m['megabytes'] / frames:.1f}"
        moving, flicker = _cell(m, "moving", ".3f"), _cell(m, "flicker", ".3f")
        quality = [f"{m['psnr']:.3f}", moving, f"{m['ssim']:.4f}", _cell(m, "lpips", ".4f"), flicker]
        size = [f"{m['megabytes']:.3f}", kilobytes, f"{m['megabytes'] / m['share']:.2f}"]
        rows.append([name_of(variant), *quality, *size, f"{m['minutes']:.2f}"])
    return PaperTable(
        "Baselines, rebuilt on our kernels, with the cameras, images and first keyframe of ours. Size in MB of the reel, which "
        "our codec writes; V3-like uses H.265. Float32: the same points and offsets uncompressed. Time in minutes; means over "
        f"captures.{TIMES}",
        [
            *("Method", "PSNR ↑", "moving PSNR ↑", "SSIM ↑", "LPIPS ↓", "Flicker ↓"),
            *("Size ↓", "KB/frame ↓", "Float32", "Time"),
        ],
        rows,
    )


def comparison(bench: PaperBench) -> PaperTable:
    """Return Table 1."""
    rows = []
    for variant in OTHERS:
        m = means(bench, variant)
        quality = f"{m['psnr']:.2f}", f"{m['ssim']:.3f}", _cell(m, "lpips", ".3f"), f"{m['megabytes']:.2f}"
        rows.append([name_of(variant), *quality, MEASURED])
    return PaperTable(
        "Table 1. Quantitative comparisons. Size in MB." + comparable(TABLE_1, bench.captures) + TIMES,
        ["Methods", "PSNR ↑", "SSIM ↑", "LPIPS ↓", "Size ↓", "Source"],
        rows + published_rows(TABLE_1, bench.captures),
    )


def efficiency(bench: PaperBench) -> PaperTable:
    """Return Table 2."""
    rows = []
    for variant in (INDEPENDENT, STREAMING, FULL):
        m = means(bench, variant)
        cost = f"{m['minutes']:.1f}", _cell(m, "fps", ".1f")
        rows.append([name_of(variant), f"{m['psnr']:.2f}", f"{m['megabytes']:.2f}", *cost, MEASURED])
    devices = {v: bench.measure(next(iter(bench.captures)), v).report.device for v in (INDEPENDENT, STREAMING, FULL)}
    device = ", ".join(f"{name_of(v)}: {device}" for v, device in devices.items())
    device = devices[FULL] if len({*devices.values()}) == 1 else device
    return PaperTable(
        f"Table 2. Quantitative comparisons. Size in MB, time in minutes on this machine ({device}); FPS of our CPU renderer."
        + comparable(TABLE_2, bench.captures)
        + TIMES,
        ["Methods", "PSNR", "Size", "Time", "FPS", "Source"],
        rows + published_rows(TABLE_2, bench.captures),
    )


def long_videos(bench: PaperBench) -> PaperTable:
    """Return Table 3."""
    rows = []
    for variant in LONG:
        m = means(bench, variant)
        rows.append([name_of(variant), f"{m['psnr']:.2f}", f"{m['megabytes']:.2f}", MEASURED])
    return PaperTable(
        "Table 3. Quantitative comparisons on long videos. Size in MB." + comparable(TABLE_3, bench.captures),
        ["Methods", "PSNR ↑", "Size ↓", "Source"],
        rows + published_rows(TABLE_3, bench.captures),
    )


def full_length(bench: PaperBench) -> PaperTable:
    """Return Table 5. Points are counted once in each layer and in each group."""
    rows = []
    for name in bench.captures:
        found = bench.measure(name, FULL)
        manifest, report = ReelReader(found.run / "reel").manifest, found.report
        points = sum(entry.points for entry in (*manifest.layers, *manifest.groups))
        lpips = "-" if report.lpips is None else f"{report.lpips:.4f}"
        quality = f"{report.psnr:.3f}", f"{report.ssim:.4f}", lpips, f"{report.reel_bytes / 1e6:.2f}"
        rows.append([name, *quality, f"{points:,}", MEASURED])
    rows += [[scene, *numbers, "published, DeskGames"] for scene, numbers in TABLE_5.items()]
    return PaperTable(
        "Table 5. Metrics of our method on whole videos. Size in MB. Published rows are the paper's, of other captures: they "
        "cannot be compared with measured rows.",
        ["Scenes", "PSNR ↑", "SSIM ↑", "LPIPS ↓", "Size ↓", "Points ↓", "Source"],
        rows,
    )


def quality_and_size(bench: PaperBench) -> PaperTable:
    """Return the points of Figure 15: size and PSNR of each method."""
    rows = []
    for variant in ALL:
        m = means(bench, variant)
        rows.append([name_of(variant), f"{m['megabytes']:.4f}", f"{m['psnr']:.3f}", MEASURED])
    rows += [
        [method, size, psnr, source]
        for method, psnr, size, _, _, source in published_rows(TABLE_2, bench.captures)
        if size != "N/A" and has_own(TABLE_2, bench.captures)
    ]
    return PaperTable(
        "Figure 15. Rendering quality and storage: size in MB and PSNR in dB, means over captures." + TIMES,
        ["Method", "Size", "PSNR", "Source"],
        rows,
    )


def name_of(variant: str) -> str:
    """Return the name of a variant in tables of methods."""
    return "Ours" if variant == FULL else variant


def _cell(numbers: dict[str, float], name: str, style: str) -> str:
    return f"{numbers[name]:{style}}" if name in numbers else "-"


COMPARISONS: dict[str, PaperResult] = {
    "1": PaperResult("comparison with other methods", OTHERS, comparison),
    "2": PaperResult("quality, size, time and speed of methods", (INDEPENDENT, STREAMING, FULL), efficiency),
    "3": PaperResult("long videos", LONG, long_videos),
    "5": PaperResult("whole videos", (FULL,), full_length),
    "baselines": PaperResult("ours beside all baselines", ALL, baselines),
    "figure15": PaperResult("quality and size of methods", ALL, quality_and_size),
}
"""Tables of methods by their number."""
