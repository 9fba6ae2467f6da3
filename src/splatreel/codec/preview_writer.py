"""Writing of previews of a run. It is apart from `preview.py` because servers import that, and encoders import numba."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.presentation import Limits
from splatreel.codec.preview import FOLDER, numbered_previews
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


def write_preview(out: Path, header: ReelHeader, limits: Limits | None, points: Gaussians) -> Path:
    """Write another preview of a run in the folder `out`, then delete the older ones. Return its folder."""
    before = numbered_previews(out)
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
