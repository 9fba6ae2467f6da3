"""What the paper compares with: no motion layering (Table 8, and V3 in Table 4), and a single frame (Table 9)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.config import EncodeConfig
from splatreel.evaluation.uncompressed import UncompressedReel
from splatreel.recon.encode.header import open_writer
from splatreel.recon.run.store import Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


def whole_groups(undecoded: UncompressedReel, index: int) -> Group:
    """A group that carries all points that are seen in it: the static ones are dynamic points that do not move."""
    group, (static, _) = undecoded.group(index), undecoded.static(index)
    resting = static[group.alive]
    frames, still = group.frames, len(resting)
    rest = np.zeros((frames, still, 4), np.float32)
    rest[..., 0] = 1
    dx = np.concatenate([group.dx, np.zeros((frames, still, 3), np.float32)], 1)
    dq = np.concatenate([group.dq, rest], 1)
    points = Gaussians.concatenate([group.dynamic, resting])
    shade = group.shade
    if shade is not None:
        shade = np.concatenate([shade, np.zeros((frames, still, 4), np.float32)], 1)
    return Group(index, group.first_frame, points, dx, dq, np.zeros(0, bool), shade)


def write_unlayered(run: Path, reel: Path, config: EncodeConfig) -> None:
    """A reel without layers, of the checkpoints of a run."""
    undecoded = UncompressedReel(run / "work", run / "reel")
    writer = open_writer(Store(run / "work"), reel, config, resume=False)
    for index in range(undecoded.store.finished_groups()):
        writer.add_group(whole_groups(undecoded, index))
    writer.finish()


def write_first_frame(run: Path, reel: Path, config: EncodeConfig) -> None:
    """A reel of the first frame: all of its points are static."""
    group = whole_groups(UncompressedReel(run / "work", run / "reel"), 0)
    points = group.at(0)
    writer = open_writer(Store(run / "work"), reel, config, resume=False)
    writer.add_layer(0, 0, points)
    none = Gaussians.empty(0), np.zeros((1, 0, 3), np.float32), np.zeros((1, 0, 4), np.float32)
    writer.add_group(Group(0, 0, *none, np.ones(len(points), bool)))
    writer.finish()


def float32_bytes(undecoded: UncompressedReel, groups: int) -> dict[str, int]:
    """Bytes of the arrays as they are, without layers: `points` and `offsets` of every group, `frames`: points at each frame."""
    sizes = {"points": 0, "offsets": 0, "frames": 0}
    for index in range(groups):
        group = undecoded.group(index)
        count = len(group.dynamic) + int(group.alive.sum())
        point = 4 * (3 + 4 + 3 + 1 + 3 * group.dynamic.sh.shape[1])
        sizes["points"] += point * count
        sizes["offsets"] += 28 * count * group.frames
        sizes["frames"] += point * count * group.frames
    return sizes
