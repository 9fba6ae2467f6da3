"""Reader of streamed SOG, PlayCanvas's format of detail levels: a lod-meta.json, and SOG files that hold parts of the levels.

A tree divides the scene. Each node names, for each level, a range of points in one of the files. Level 0 is the finest.

Source:
    https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/streamed-sog/
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget
from splatreel.base.ply_table import Columns
from splatreel.base.untrusted import read_json
from splatreel.formats.sog import is_sog_antialiased, read_sog
from splatreel.formats.splat_columns import Remarks, concatenate_columns

LOD_META = "lod-meta.json"
VERSION = 1
Ranges = dict[int, list[tuple[int, int]]]
"""Ranges of points, first and count, by the number of their file."""


@dataclass(frozen=True)
class _Scene:
    """SOG files, the ranges of points of each level, finest first, and the file of the surroundings if there is one."""

    files: list[Path]
    levels: list[Ranges]
    environment: Path | None


def read_streamed_sog(path: Path, remarks: Remarks, budget: MemoryBudget = UNRAISED) -> Columns:
    """Return the columns of the finest level, as `read_sog` does.

    Args:
        path: The lod-meta.json.
        remarks: Receives how many levels were left out.
        budget: Memory that reading one of the files may take.

    Raises:
        GaussiansError: A file is missing, damaged, of another version, or takes too much memory.
    """
    scene = _read_meta(path)
    parts = [
        _take(read_sog(scene.files[file], budget), ranges, scene.files[file])
        for file, ranges in sorted(scene.levels[0].items())
    ]
    if scene.environment is not None:
        parts.append(read_sog(scene.environment, budget))
    if not parts:
        raise GaussiansError(f"{path}: names no points of its finest level. Export it again.")
    remarks.add(f"Streamed SOG: the finest of its {len(scene.levels)} detail levels was read", path)
    return concatenate_columns(parts)


def is_streamed_sog_antialiased(path: Path) -> bool:
    """Return whether the points are marked as trained with antialiasing. Raises as `read_streamed_sog` does."""
    scene = _read_meta(path)
    return any(is_sog_antialiased(scene.files[file]) for file in sorted(scene.levels[0])[:1])


def files_of(path: Path) -> list[Path]:
    """Return the SOG files that a lod-meta.json names. Raises as `read_streamed_sog` does."""
    scene = _read_meta(path)
    return scene.files if scene.environment is None else [*scene.files, scene.environment]


def _read_meta(path: Path) -> _Scene:
    meta = read_json(path, GaussiansError)
    try:
        if meta.get("version", VERSION) != VERSION:
            raise ValueError(f"version {meta['version']!r:.20}")
        files = [_inside(path, name) for name in meta["filenames"]]
        levels: list[Ranges] = [defaultdict(list) for _ in range(_whole(meta["lodLevels"], 1, 100))]
        nodes = [meta["tree"]]
        while nodes:
            node = nodes.pop()
            for level, entry in node.get("lods", {}).items():
                file = _whole(entry["file"], 0, len(files) - 1)
                levels[_whole(int(level), 0, len(levels) - 1)][file].append(
                    (_whole(entry["offset"]), _whole(entry["count"]))
                )
            nodes += node.get("children", [])
        _check_counts(meta.get("counts"), levels)
        environment = _inside(path, meta["environment"]) if meta.get("environment") else None
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise GaussiansError(
            f"{path}: is not a {LOD_META} as splat-transform writes it ({type(error).__name__}: {error!s:.80}). Export it again."
        ) from error
    return _Scene(files, levels, environment)


def _check_counts(counts: Any, levels: list[Ranges]) -> None:
    """Check the stated numbers of points of the levels, which older files lack."""
    found = [sum(count for ranges in level.values() for _, count in ranges) for level in levels]
    if counts is not None and counts != found:
        raise ValueError(f"its levels hold {found} points, and it states {counts}")


def _whole(value: Any, least: int = 0, most: int = 1 << 40) -> int:
    if type(value) is not int or not least <= value <= most:
        raise ValueError(f"{value!r:.20} is not a whole number from {least} to {most}")
    return value


def _inside(path: Path, name: Any) -> Path:
    """Return a file beside or below the lod-meta.json."""
    parts = PurePosixPath(name).parts
    if not parts or ".." in parts or PurePosixPath(name).is_absolute() or "\\" in name:
        raise ValueError(f"{name!r:.80} is not a file below {path.parent}")
    return path.parent.joinpath(*parts)


def _take(columns: Columns, ranges: list[tuple[int, int]], file: Path) -> Columns:
    count = len(columns["x"])
    over = next(((first, length) for first, length in ranges if first + length > count), None)
    if over is not None:
        raise GaussiansError(
            f"{file}: has {count:,} points, and {LOD_META} asks for {over[1]:,} from point {over[0]:,}. Export it again."
        )
    kept = np.zeros(count, bool)
    for first, length in ranges:
        kept[first : first + length] = True
    return columns if kept.all() else {name: column[kept] for name, column in columns.items()}
