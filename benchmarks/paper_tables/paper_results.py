"""The paper's tables and figures that need several reconstructions, with its own numbers where the dataset is the same."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean

from bench.rate_distortion import Sweep, sweep_of
from paper_tables.paper_bench import FULL, INDEPENDENT, Measured, PaperBench
from paper_tables.paper_table import PaperTable
from paper_tables.paper_tables import ChainedGroups, paper_tables
from paper_tables.published import dataset_of
from splatreel.codec.reader import ReelReader
from splatreel.scene.group import group_spans

ABLATIONS = (FULL, "w/o Reg.", "w/o Prg.", "w/o Adp.", "w/o Rfn.")
LENGTHS = tuple(f"length {length}" for length in (10, 20, 30, 40, 50))
PAPER_6 = {
    FULL: ("32.554", "0.9488", "0.1282", "21.21", "8.32%"),
    "w/o Reg.": ("32.535", "0.9486", "0.1277", "22.46", "8.91%"),
    "w/o Prg.": ("32.448", "0.9480", "0.1285", "20.37", "7.97%"),
    "w/o Adp.": ("32.412", "0.9476", "0.1291", "19.58", "8.13%"),
    "w/o Rfn.": ("31.205", "0.9398", "0.1353", "20.62", "8.86%"),
}
PAPER_7 = {
    "PSNR ↑": ("32.583", "32.574", "32.554", "32.182", "32.207"),
    "Size ↓": ("36.74", "26.24", "21.21", "19.22", "16.44"),
    "Time ↓": ("102.8", "88.8", "72.5", "65.5", "64.0"),
}
PROCEDURES = {
    "Gaussian Point Init.": ("points", "keyframe"),
    "Motion Layering Init.": ("layering",),
    "GOG Reconstruction": ("tracking", "group"),
    "Cameras and exposure": ("poses", "exposure"),
    "Encoding": ("encode",),
}
"""Stages of a run that make up each procedure of Table 12. Cameras and exposure are not in the paper."""


@dataclass(frozen=True)
class PaperResult:
    """A table or figure of the paper.

    Attributes:
        title: What it shows.
        variants: Variants that it needs.
        table: Function that measures what is missing and returns the numbers.
    """

    title: str
    variants: Sequence[str]
    table: Callable[[PaperBench], PaperTable]


def ablation(bench: PaperBench) -> PaperTable:
    """Return Table 6."""
    rows = []
    for variant in ABLATIONS:
        rows.append([variant, *_quality(means(bench, variant)), *(PAPER_6[variant] if same_dataset(bench) else ())])
    return PaperTable(
        "Table 6. Ablation on the GOG reconstruction. Size in MB, mean over captures; LPIPS of every tenth frame; CR is the "
        "share of float32 numbers." + _equal_variants(bench, ABLATIONS),
        ["Methods", *_heads(), *([f"paper: {head}" for head in _heads()] if same_dataset(bench) else ())],
        rows,
    )


def group_lengths(bench: PaperBench) -> PaperTable:
    """Return Table 7."""
    found = [means(bench, variant) for variant in LENGTHS]
    rows = [
        ["PSNR ↑", *(f"{m['psnr']:.3f}" for m in found)],
        ["Size ↓", *(f"{m['megabytes']:.2f}" for m in found)],
        ["Time ↓", *(f"{m['minutes']:.1f}" for m in found)],
    ]
    if same_dataset(bench):
        rows += [[f"paper: {name}", *values] for name, values in PAPER_7.items()]
    return PaperTable(
        "Table 7. Ablation on group length. Size in MB, time in minutes, means over captures."
        + _equal_variants(bench, LENGTHS),
        ["Group Length", *(variant.removeprefix("length ") for variant in LENGTHS)],
        rows,
    )


def procedures(bench: PaperBench) -> PaperTable:
    """Return Table 12."""
    found = [bench.measure(name, FULL) for name in bench.captures]
    frames = fmean(capture.frames for capture in bench.captures.values())
    config, rows = bench.config.for_video(round(frames)), []
    iterations = {
        "Gaussian Point Init.": f"{config.keyframe.first_iterations:,} ({config.keyframe.refine_iterations:,})/group",
        "GOG Reconstruction": f"{config.group.iterations_per_frame:,}/frame",
    }
    for procedure, stages in PROCEDURES.items():
        seconds = fmean(sum(m.report.seconds.get(stage, 0.0) for stage in stages) for m in found)
        rows.append([procedure, f"{seconds / 60:.2f} min", f"{seconds / frames:.2f} s", iterations.get(procedure, "-")])
    decoding = [m.report.decode_ms_per_frame for m in found if m.report.decode_ms_per_frame is not None]
    if decoding:
        rows.append(["Decoding", f"{fmean(decoding) * frames:.0f} ms", f"{fmean(decoding):.1f} ms", "-"])
    return PaperTable(
        f"Table 12. Time of reconstruction and compression on {found[0].report.device}, mean over captures.",
        ["Procedures", "Time/scene", "Time/frame", "Iterations"],
        rows,
    )


def per_scene_ablation(bench: PaperBench) -> PaperTable:
    """Return Table 13, without the deformation encoding, which is Table 10."""
    variants = (*ABLATIONS, *(variant for variant in LENGTHS if variant != f"length {bench.config.group.length}"))
    rows = []
    for name in bench.captures:
        found = [bench.measure(name, variant) for variant in variants]
        rows.append([name, "PSNR ↑", *(f"{m.report.psnr:.2f}" for m in found)])
        rows.append([name, "Size ↓", *(f"{m.report.reel_bytes / 1e6:.2f}" for m in found)])
    averages = [means(bench, variant) for variant in variants]
    rows.append(["Average", "PSNR ↑", *(f"{m['psnr']:.2f}" for m in averages)])
    rows.append(["Average", "Size ↓", *(f"{m['megabytes']:.2f}" for m in averages)])
    caption = "Table 13. Per-scene ablation metrics. Size in MB." + _equal_variants(bench, variants)
    return PaperTable(caption, ["Scene", "Metrics", *variants], rows)


def per_scene(bench: PaperBench) -> PaperTable:
    """Return our rows of Tables 14 to 17.

    The mark * is before compression, where only PSNR is measured.
    """
    rows = []
    for name in bench.captures:
        found = bench.measure(name, FULL)
        before = found.report.psnr_undecoded
        rows.append([name, "Ours*", "-" if before is None else f"{before:.3f}", "-", "-", _mb(found.float32_bytes)])
        rows.append([name, "Ours", *_quality(_numbers(found))[:4]])
    rows.append(["Average", "Ours", *_quality(means(bench, FULL))[:4]])
    return PaperTable(
        "Tables 14 to 17. Size in MB; LPIPS of every tenth frame. *: without compression, as float32 numbers.",
        ["Scene", "Method", *_heads()[:4]],
        rows,
    )


def error_accumulation(bench: PaperBench) -> PaperTable:
    """Return the curves of Figure 10: PSNR of each frame with and without refinement at keyframes, mean over captures."""
    curves = [per_frame_psnr(bench, variant) for variant in (FULL, "w/o Rfn.")]
    frames = sorted(set(curves[0]) & set(curves[1]))
    return PaperTable(
        "Figure 10. Error accumulation without refinement: PSNR of each frame in dB, mean over captures."
        + _equal_variants(bench, (FULL, "w/o Rfn.")),
        ["frame", FULL, "w/o Rfn."],
        [[str(frame), *(f"{curve[frame]:.3f}" for curve in curves)] for frame in frames],
    )


def codec_table(bench: PaperBench, number: str, every: int) -> str:
    """Return Table 4, 8, 9 or 10 of each capture as Markdown.

    Args:
        bench: Reconstructions.
        number: Number of the table.
        every: Distance of the frames that are compared with the held-out cameras.
    """
    parts = []
    for name, capture in bench.captures.items():
        run = bench.measure(name, FULL).run
        record = run.parent / f"codec-{run.name}.jsonl"
        sweep = sweep_of(run, capture, every, bench.progress, record)
        chained = chained_groups(bench.measure(name, INDEPENDENT)) if number == "8" else None
        text = paper_tables(sweep, Sweep(run, capture, [0], bench.progress, record), chained)
        table = next(part for part in re.split(r"^(?=Table )", text, flags=re.M) if part.startswith(f"Table {number}."))
        parts.append(f"{name}. {table}")
    return "\n".join(parts)


def chained_groups(measured: Measured) -> ChainedGroups:
    """Return config. 1 of Table 8 for the reconstruction of independent groups."""
    manifest, report = ReelReader(measured.run / "reel").manifest, measured.report
    numbers = 3 + 4 + 3 + 1 + 3 * (manifest.sh_degree + 1) ** 2
    points = sum(4 * numbers * group.points for group in manifest.groups)
    offsets = sum(28 * group.points * group.frames for group in manifest.groups)
    return ChainedGroups(points, offsets, report.psnr_undecoded or report.psnr, measured.minutes)


CODEC_TABLES = ("4", "8", "9", "10")
"""Tables that need one reconstruction, encoded in several ways."""
RESULTS: dict[str, PaperResult] = {
    "6": PaperResult("ablation on the GOG reconstruction", ABLATIONS, ablation),
    "7": PaperResult("ablation on group length", LENGTHS, group_lengths),
    "12": PaperResult("time of each procedure", (FULL,), procedures),
    "13": PaperResult("per-scene ablation", (*ABLATIONS, *LENGTHS), per_scene_ablation),
    "14": PaperResult("per-scene quality, as Tables 14 to 17", (FULL,), per_scene),
    "figure10": PaperResult("error accumulation", (FULL, "w/o Rfn."), error_accumulation),
}
"""Tables and figures by their number."""


def per_frame_psnr(bench: PaperBench, variant: str) -> dict[int, float]:
    """Return the PSNR of each frame that all captures have, mean over captures."""
    found = [
        {frame["frame"]: frame["psnr"] for frame in bench.measure(name, variant).report.per_frame}
        for name in bench.captures
    ]
    return {frame: fmean(values[frame] for values in found) for frame in set.intersection(*map(set, found))}


def means(bench: PaperBench, variant: str) -> dict[str, float]:
    """Return the numbers of a variant, each as the mean over captures. A metric that a capture lacks is left out."""
    found = [_numbers(bench.measure(name, variant)) for name in bench.captures]
    return {name: fmean(numbers[name] for numbers in found) for name in found[0] if all(name in n for n in found)}


def same_dataset(bench: PaperBench) -> bool:
    """Return whether all captures are scenes of Neu3DV, so that the paper's averages can stand beside."""
    return dataset_of(bench.captures) == "Neu3DV"


def _numbers(measured: Measured) -> dict[str, float]:
    report = measured.report
    numbers = {
        "psnr": report.psnr,
        "ssim": report.ssim,
        "megabytes": report.reel_bytes / 1e6,
        "share": report.reel_bytes / measured.float32_bytes,
        "minutes": measured.minutes,
    }
    moving = report.moving and report.moving.get("psnr")
    flicker = report.flicker_borders if report.flicker is None else report.flicker  # frames may be groups of their own
    more = {"lpips": report.lpips, "moving": moving, "flicker": flicker, "fps": report.render_fps}
    return numbers | {name: value for name, value in more.items() if value is not None}


def _heads() -> list[str]:
    return ["PSNR ↑", "SSIM ↑", "LPIPS ↓", "Size ↓", "CR ↓"]


def _quality(numbers: dict[str, float]) -> list[str]:
    """Return the cells of PSNR, SSIM, LPIPS, size and compression rate."""
    lpips = f"{numbers['lpips']:.4f}" if "lpips" in numbers else "-"
    size = f"{numbers['megabytes']:.2f}"
    return [f"{numbers['psnr']:.3f}", f"{numbers['ssim']:.4f}", lpips, size, f"{numbers['share']:.2%}"]


def _equal_variants(bench: PaperBench, variants: Sequence[str]) -> str:
    """Return sentences about variants with the result of the first one, and the cause, such as a video of one group."""
    first, *others = variants
    same = [variant for variant in others if bench.settings(variant) == bench.settings(first)]
    equal = [
        variant for variant in others if variant not in same and _results(bench, variant) == _results(bench, first)
    ]
    text = f" The settings of {_listed(same)} are those of {first} here." if same else ""
    return text + (f" {_listed(equal)} gave the same reel as {first}{_cause(bench, first)}." if equal else "")


def _results(bench: PaperBench, variant: str) -> list[tuple[float, int]]:
    reports = [bench.measure(name, variant).report for name in bench.captures]
    return [(report.psnr, report.reel_bytes) for report in reports]


def _cause(bench: PaperBench, variant: str) -> str:
    """Return why other settings of groups can have no effect, if that is known."""
    if all(bench.measure(name, variant).report.points_dynamic == 0 for name in bench.captures):
        return ", because nothing moves: no motion was trained"
    group = bench.settings(variant).group
    if all(len(group_spans(capture.frames, group.length, group.overlap)) == 1 for capture in bench.captures.values()):
        return ", because the video has one group: no later keyframe was refined, and no other group trained"
    return ""


def _listed(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _mb(count: int) -> str:
    return f"{count / 1e6:.2f}"
