"""Previews of a run: reels of one frame that show its first keyframe while it trains.

They lie in numbered folders of OUT/work/preview. A player that shows one of them notices the next, and at last the reel of the run.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.presentation import Limits
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

FOLDER = Path("work", "preview")
"""Folder of the previews in the output folder of a run."""


def newest_preview(out: Path) -> Path | None:
    """Return the folder of the newest preview of a run in the folder `out`; None if there is none."""
    found = _numbered_previews(out)
    return found[max(found)] if found else None


def remove_previews(out: Path) -> None:
    """Delete all previews of a run in the folder `out`."""
    shutil.rmtree(out / FOLDER, ignore_errors=True)


def _numbered_previews(out: Path) -> dict[int, Path]:
    try:
        manifests = list((out / FOLDER).glob("*/manifest.json"))
    except OSError:  # the run deletes them at this moment
        return {}
    return {int(path.parent.name): path.parent for path in manifests if path.parent.name.isdecimal()}


def write_preview(out: Path, header: ReelHeader, limits: Limits | None, points: Gaussians) -> Path:
    """Write another preview of a run in the folder `out`, then delete the older ones. Return its folder."""
    before = _numbered_previews(out)
    folder = out / FOLDER / f"{max(before, default=0) + 1:04d}"
    shutil.rmtree(folder, ignore_errors=True)  # of a process that was killed before it wrote the manifest
    writer = ReelWriter(folder, header, config=EncodeConfig())
    writer.add_layer(0, 0, points)
    none = Gaussians.empty(header.sh_degree)
    shown = np.ones(len(points), bool)
    writer.present(replace(writer.manifest.presentation, limits=limits))
    writer.add_group(Group(0, 0, none, np.zeros((1, 0, 3), np.float32), np.zeros((1, 0, 4), np.float32), shown))
    for old in before.values():
        shutil.rmtree(old, ignore_errors=True)
    return folder
