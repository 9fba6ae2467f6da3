"""The paper's tables about size (4, 8, 9 and 10) in their own layout: one reconstruction, encoded in several ways.

Sizes are of real files in megabytes, except Table 8, config. 1, and Table 4 before compression, which count float32
numbers. PSNR is of the run's held-out cameras. Table 9 uses the first frame. Entries that would need another training
say so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.rate_distortion import PRINTED, RatePoint, Sweep
from splatreel.codec.reader import ReelReader
from splatreel.config import EncodeConfig
from splatreel.evaluation.evaluate import UncompressedReel
from splatreel.run.output.group_writer import open_writer
from splatreel.run.store import Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

FLOATS = PRINTED.with_h265(position_bits=None, quat_bits=None, opacity_bits=None, scale_bits=None, color_bits=None)
UNQUANTIZED = replace(FLOATS.with_h265(source="raw"), sh_entries=None)
V3 = PRINTED.with_h265(source="ori", crf_attributes=20, log_scales=True)
TABLE_9: dict[tuple[str, ...], EncodeConfig] = {
    ("-", "-", "-", "-", "-"): replace(FLOATS, sh_entries=None),
    ("-", "-", "-", "-", "2^10"): FLOATS,
    ("8", "8", "12", "8", "2^10"): PRINTED.with_h265(position_bits=None),
    ("8", "8", "8", "8", "2^10"): PRINTED.with_h265(position_bits=None, scale_bits=8),
    ("8", "8", "12", "8", "2^8"): replace(PRINTED.with_h265(position_bits=None), sh_entries=256),
    ("8", "8", "12", "8", "No SH"): replace(PRINTED.with_h265(position_bits=None), sh_entries=0),
}
TABLE_10: dict[tuple[str, ...], EncodeConfig] = {
    ("-", "-", "-"): PRINTED.with_h265(source="raw", position_bits=None),
    ("ofs", "20", "-"): PRINTED.with_h265(position_bits=None),
    ("ofs", "20", "20"): PRINTED,
    ("ofs", "20", "12"): PRINTED.with_h265(position_bits=12),
    ("ofs", "30", "12"): PRINTED.with_h265(position_bits=12, crf=30),
    ("ori", "20", "20"): PRINTED.with_h265(source="ori"),
    ("dif", "20", "20"): PRINTED.with_h265(source="dif"),
}


@dataclass(frozen=True)
class ChainedGroups:
    """Config. 1 of Table 8: independent groups in which all points move, as float32 numbers.

    Attributes:
        points: Bytes of the points.
        offsets: Bytes of their offsets.
        psnr: PSNR in dB.
        minutes: Minutes of the reconstruction.
    """

    points: int
    offsets: int
    psnr: float
    minutes: float


def paper_tables(sweep: Sweep, first: Sweep, chained: ChainedGroups | None = None) -> str:
    """Return Tables 4, 8, 9 and 10 as Markdown.

    Args:
        sweep: Sweep of all frames.
        first: Sweep of the first frame only.
        chained: Config. 1 of Table 8; None counts its size from the run, and it has no PSNR.
    """
    ten = [sweep.measure(f"table 10: {' '.join(key)}", config) for key, config in TABLE_10.items()]
    nine = [
        first.measure(f"table 9: {' '.join(key)}", config, lambda reel, c: write_first_frame(first.run, reel, c))
        for key, config in TABLE_9.items()
    ]
    plain = sweep.measure("table 8: layers, float32", UNQUANTIZED)
    v3 = sweep.measure("table 4: V3", V3, lambda reel, c: write_unlayered(sweep.run, reel, c))
    undecoded = UncompressedReel(sweep.run / "work", sweep.run / "reel")
    sizes = float32_bytes(undecoded, len(ReelReader(sweep.run / "reel").manifest.groups))
    parts = [
        _table_4(sweep.before, v3, ten, sizes),
        _table_8(sweep.run, plain, ten, sizes, chained),
        _table_9(nine),
        _table_10(ten),
    ]
    return "\n".join(parts)


def _table_4(before: float, v3: RatePoint, ten: list[RatePoint], sizes: dict[str, int]) -> str:
    rows = [
        ["PSNR", f"{before:.2f}", f"{v3.psnr:.2f}", f"{before:.2f}", f"{ten[2].psnr:.2f}"],
        ["Size", _mb(sizes["frames"]), _mb(v3.bytes), _mb(ten[0].bytes), _mb(ten[2].bytes)],
    ]
    return _markdown(
        "Table 4. V3's compression and the paper's, of the same reconstruction (the paper trains V3's own).",
        ["", "V3 w/o Comp.", "V3 w/ Comp.", "Ours w/o Comp.", "Ours w/ Comp."],
        rows,
    )


def _table_8(
    run: Path, plain: RatePoint, ten: list[RatePoint], sizes: dict[str, int], chained: ChainedGroups | None
) -> str:
    """Return Table 8. Config. 1 has every point in every group, with offsets. Without `chained` it is counted, not trained."""
    points, offsets = (sizes["points"], sizes["offsets"]) if chained is None else (chained.points, chained.offsets)
    psnr, time = ("not trained",) * 2 if chained is None else (f"{chained.psnr:.2f}", f"{chained.minutes:.1f}")
    total = points + offsets
    seconds = Store(run / "work").seconds()
    minutes = f"{sum(seconds.values()) / 60:.1f}"
    columns = [plain, ten[0], ten[2]]
    rows = [
        ["Motion Layering", "", "✓", "✓", "✓"],
        ["Point Quantization", "", "", "✓", "✓"],
        ["Deformation Encoding", "", "", "", "✓"],
        ["Size (points)", _mb(points), *[_mb(row.bytes - row.offset_bytes) for row in columns]],
        ["Size (deformations)", _mb(offsets), *[_mb(row.offset_bytes) for row in columns]],
        ["Size (whole model)", _mb(total), *[_mb(row.bytes) for row in columns]],
        ["Compression Rate", "100%", *[f"{row.bytes / total:.1%}" for row in columns]],
        ["PSNR", psnr, *[f"{row.psnr:.2f}" for row in columns]],
        ["Time", time, "", "", minutes],
    ]
    return _markdown("Table 8. Ablation on model size.", ["Config.", "#1", "#2", "#3", "Full"], rows)


def _table_9(nine: list[RatePoint]) -> str:
    header = ["Config.", "q", "o", "s", "c^base", "c^rest", "PSNR", "Size", "CR"]
    return _markdown("Table 9. Ablation on Gaussian point quantization, frame 0.", header, _rows(TABLE_9, nine))


def _table_10(ten: list[RatePoint]) -> str:
    header = ["Config.", "Source", "CRF_265", "QP_DRC", "PSNR", "Size", "CR"]
    return _markdown("Table 10. Ablation on deformation encoding.", header, _rows(TABLE_10, ten))


def _rows(keys: dict[tuple[str, ...], EncodeConfig], rows: list[RatePoint]) -> list[list[str]]:
    return [
        [f"#{number}", *key, f"{row.psnr:.3f}", _mb(row.bytes), f"{row.bytes / rows[0].bytes:.1%}"]
        for number, (key, row) in enumerate(zip(keys, rows, strict=True), 1)
    ]


def _mb(size: int) -> str:
    return f"{size / 1e6:.3g}" if size < 1e8 else f"{size / 1e6:.0f}"


def _markdown(title: str, header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return f"{title}\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def group_without_layers(undecoded: UncompressedReel, index: int) -> Group:
    """Return a group with all points visible in it. Static points become dynamic points without motion."""
    group, (static, _) = undecoded.group(index), undecoded.static(index)
    living = static[group.alive]
    frames, still = group.frames, len(living)
    rest = np.zeros((frames, still, 4), np.float32)
    rest[..., 0] = 1
    dx = np.concatenate([group.dx, np.zeros((frames, still, 3), np.float32)], 1)
    dq = np.concatenate([group.dq, rest], 1)
    points = Gaussians.concatenate([group.dynamic, living])
    shade = group.shade
    if shade is not None:
        shade = np.concatenate([shade, np.zeros((frames, still, 4), np.float32)], 1)
    return Group(index, group.first_frame, points, dx, dq, np.zeros(0, bool), shade)


def write_unlayered(run: Path, reel: Path, config: EncodeConfig) -> None:
    """Write a reel without layers from the checkpoints of a run."""
    undecoded = UncompressedReel(run / "work", run / "reel")
    writer = open_writer(Store(run / "work"), reel, config, resume=False)
    for index in range(undecoded.store.finished_groups()):
        writer.add_group(group_without_layers(undecoded, index))
    writer.finish()


def write_first_frame(run: Path, reel: Path, config: EncodeConfig) -> None:
    """Write a reel of the first frame, in which all points are static."""
    group = group_without_layers(UncompressedReel(run / "work", run / "reel"), 0)
    points = group.at(0)
    writer = open_writer(Store(run / "work"), reel, config, resume=False)
    writer.add_layer(0, 0, points)
    none = Gaussians.empty(0), np.zeros((1, 0, 3), np.float32), np.zeros((1, 0, 4), np.float32)
    writer.add_group(Group(0, 0, *none, np.ones(len(points), bool)))
    writer.finish()


def float32_bytes(undecoded: UncompressedReel, groups: int) -> dict[str, int]:
    """Return the size of the uncompressed arrays without layers.

    `points` and `offsets` are summed over the groups. `frames` counts the points of every frame.
    """
    sizes = {"points": 0, "offsets": 0, "frames": 0}
    for index in range(groups):
        group = undecoded.group(index)
        count = len(group.dynamic) + int(group.alive.sum())
        point = 4 * (3 + 4 + 3 + 1 + 3 * group.dynamic.sh.shape[1])
        sizes["points"] += point * count
        sizes["offsets"] += 28 * count * group.frames
        sizes["frames"] += point * count * group.frames
    return sizes
