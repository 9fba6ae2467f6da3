"""A whole reconstruction encoded again with other settings, without training."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import torch

from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.errors import ReconstructionError
from splatreel.progress import Progress
from splatreel.recon.encode.header import open_writer
from splatreel.recon.encode.publisher import Present, Publisher, nothing_more
from splatreel.recon.encode.rate import meet_rate
from splatreel.recon.run.store import Store


def reencode(
    work: Path,
    reel: Path,
    config: EncodeConfig,
    device: torch.device,
    progress: Progress,
    mbps: float | None = None,
    present: Present = nothing_more,
) -> Path:
    """Write a reel from the checkpoints of a reconstruction; returns the reel's folder.

    device: where importance is measured that no checkpoint has. mbps: megabits a second of video that the reel shall have; its
    coarseness is then found by trying. present: adds what is there beside the points, at the end.
    """
    store = Store(work)
    count = store.finished_groups()
    if count == 0:
        raise ReconstructionError(f"{work}: holds no finished group. Run splatreel reconstruct first.")
    publisher: Publisher | None = None

    def write(coarseness: float) -> float:
        nonlocal publisher
        writer = open_writer(store, reel, dataclasses.replace(config, coarseness=coarseness), resume=False)
        publisher = Publisher(writer, store, device, publisher and publisher.measured)
        progress.stage("writing the groups", count)
        publisher.publish_all(count, progress.update)
        return megabits_a_second(writer)

    if mbps is None:
        write(config.coarseness)
    else:
        meet_rate(write, mbps)
    assert publisher is not None
    present(publisher.writer, None)
    publisher.writer.finish()
    return reel


def megabits_a_second(writer: ReelWriter) -> float:
    """Of video, by all layers and groups."""
    manifest = writer.manifest
    size = sum(file.bytes for file in (*manifest.layers, *manifest.groups))
    return 8e-6 * size / ((manifest.frames - manifest.first_frame) / manifest.fps)
