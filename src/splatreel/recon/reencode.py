"""Encode a finished reconstruction again from its checkpoints, with other settings and without training."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.codec.manifest import Manifest
from splatreel.codec.reader import ReelReader
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.errors import ReconstructionError, UsageError
from splatreel.progress import Progress, Silent
from splatreel.recon import checkpoint
from splatreel.scene.group import Group


def reencode(run: Path, reel: Path, config: EncodeConfig, *, progress: Progress | None = None) -> Manifest:
    """Write the groups whose checkpoints lie in RUN/work as a new reel; returns its manifest.

    Later groups were trained against the static points as the first encoding decoded them, so a coarser one also loses a
    little of what the closed loop gained. Raises `UsageError` where reel is the one of the run itself,
    `ReconstructionError` for checkpoints that are missing or damaged.
    """
    progress = progress or Silent()
    source = ReelReader(run / "reel").manifest
    if reel.resolve() == (run / "reel").resolve():
        raise UsageError(f"{reel}: is the reel of the run itself. Choose another --out.")
    writer = ReelWriter(
        reel,
        fps=source.fps,
        group_length=source.group_length,
        overlap=source.overlap,
        sh_degree=source.sh_degree,
        bounds=source.bounds,
        up=source.up,
        camera=source.camera,
        cameras=list(source.cameras),
        config=config,
    )
    born = {layer.group for layer in source.layers}
    orders: list[np.ndarray] = []  # of each layer: reel order now -> reel order then, which the checkpoints are in
    progress.stage("encode", len(source.groups))
    for entry in source.groups:
        folder = run / "work" / f"group{entry.group:04d}"
        if not (folder / "group.safetensors").exists():
            raise ReconstructionError(f"{folder / 'group.safetensors'}: is missing. Run `splatreel reconstruct` again.")
        if entry.group in born:
            raw = checkpoint.unpack(checkpoint.load_arrays(folder / "layer.safetensors"), "raw_")
            orders.append(writer.add_layer(entry.group, entry.first_frame, raw)[1])
        arrays = checkpoint.load_arrays(folder / "group.safetensors")
        alive = reordered(arrays["alive"].astype(bool), orders)
        dynamic = checkpoint.unpack(arrays)
        writer.add_group(Group(entry.group, entry.first_frame, dynamic, arrays["dx"], arrays["dq"], alive))
        progress.update(entry.group + 1)
    writer.finish()
    return writer.manifest


def reordered(alive: np.ndarray, orders: list[np.ndarray]) -> np.ndarray:
    """alive [S] over consecutive layers, each permuted by its order."""
    ends = np.cumsum([len(order) for order in orders])[:-1] if orders else []
    parts = [part[order] for part, order in zip(np.split(alive, ends), orders, strict=False)]
    return np.concatenate(parts) if parts else np.zeros(0, bool)
