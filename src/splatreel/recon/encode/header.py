"""What a reel says before any of its files: from the cameras, the layout and the settings."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.writer import ReelWriter
from splatreel.config import Config, EncodeConfig
from splatreel.recon.encode.sound import publish_sound
from splatreel.recon.init.layout import Layout
from splatreel.recon.run.store import Store
from splatreel.scene.camera import Camera


def header_of(cameras: list[Camera], fps: float, config: Config, layout: Layout) -> ReelHeader:
    """cameras: those that are trained on."""
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
    """A writer for a reconstruction's reel, with its sound. first_group: as of `ReelWriter`.

    Raises `ReconstructionError` if the store holds none.
    """
    header, limits = store.header()
    writer = ReelWriter(reel, header, config=config, resume=resume, first_group=first_group)
    if limits != writer.manifest.presentation.limits:
        writer.present(dataclasses.replace(writer.manifest.presentation, limits=limits))
    publish_sound(store.work, writer)
    return writer
