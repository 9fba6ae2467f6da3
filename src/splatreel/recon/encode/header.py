"""Header of a reel, and creation of its writer."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config, EncodeConfig
from splatreel.recon.encode.soundtrack import write_soundtrack
from splatreel.recon.init.layout import Layout
from splatreel.recon.run.store import Store
from splatreel.scene.camera import Camera


def header_of(cameras: list[Camera], fps: float, config: Config, layout: Layout) -> ReelHeader:
    """Create the header of a reel.

    Args:
        cameras: Training cameras.
        fps: Frames per second.
        config: Settings.
        layout: Measures of the scene.
    """
    return ReelHeader(
        fps=fps,
        group_length=config.group.length,
        overlap=config.group.overlap,
        sh_degree=config.keyframe.sh_degree,
        bounds=np.array(layout.bounds),
        up=np.array(layout.up),
        camera=cameras[len(cameras) // 2],
        cameras=cameras,
        near=layout.near,
        clearance=layout.clearance,
        antialias=config.antialias,
        background=layout.background,
    )


def open_writer(
    store: Store, reel: Path, config: EncodeConfig, resume: bool, first_group: int | None = None
) -> ReelWriter:
    """Create the writer of a reconstruction's reel, and add its soundtrack.

    Args:
        store: Checkpoints of the reconstruction.
        reel: Folder of the reel.
        config: Settings of the encoder.
        resume: Continue a reel that exists already.
        first_group: See `ReelWriter`.

    Raises:
        ReconstructionError: If the store has no header.
    """
    header, limits = store.header()
    writer = ReelWriter(reel, header, config=config, resume=resume, first_group=first_group)
    if limits != writer.manifest.presentation.limits:
        writer.present(dataclasses.replace(writer.manifest.presentation, limits=limits))
    write_soundtrack(store.work, writer)
    return writer
