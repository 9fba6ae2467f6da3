"""Encoding of a finished reconstruction with other settings, without training."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from splatreel.base.errors import ReconstructionError, UsageError
from splatreel.base.progress import Progress
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig
from splatreel.run.output.group_writer import GroupWriter, PresentationHook, no_presentation, open_writer
from splatreel.run.store import Store


def reencode(
    work: Path,
    reel: Path,
    config: EncodeConfig,
    progress: Progress,
    mbps: float | None = None,
    present: PresentationHook = no_presentation,
) -> Path:
    """Write a reel from the checkpoints of a reconstruction, and return its folder.

    Args:
        work: Folder of the checkpoints.
        reel: Folder of the reel.
        config: Settings of the encoder.
        progress: Receives the number of groups written.
        mbps: Rate to reach, Mbit/s of video, by a search of the coarseness; None uses `config.coarseness`.
        present: Adds content beside the points, at the end.

    Raises:
        ReconstructionError: If no group is finished.
    """
    store = Store(work)
    count = store.finished_groups()
    if count == 0:
        raise ReconstructionError(f"{work}: contains no finished group. Run splatreel reconstruct first.")
    group_writer: GroupWriter | None = None

    def write(coarseness: float) -> float:
        nonlocal group_writer
        writer = open_writer(store, reel, dataclasses.replace(config, coarseness=coarseness), resume=False)
        group_writer = GroupWriter(writer, store, group_writer and group_writer.measured)
        progress.stage("writing the groups", count)
        group_writer.write_all(count, progress.update)
        return megabits_per_second(writer)

    if mbps is None:
        write(config.coarseness)
    else:
        search_coarseness(write, mbps)
    assert group_writer is not None
    present(group_writer.writer, None)
    group_writer.writer.finish()
    return reel


def megabits_per_second(writer: ReelWriter) -> float:
    """Return the rate of all layers and groups, Mbit/s of video."""
    manifest = writer.manifest
    size = sum(file.bytes for file in (*manifest.layers, *manifest.groups))
    return 8e-6 * size / ((manifest.frames - manifest.first_frame) / manifest.fps)


TRIALS = 12
"""Maximum number of encodings."""


def search_coarseness(write: Callable[[float], float], mbps: float) -> float:
    """Call `write`, from a coarseness to a rate in Mbit/s, until the rate is within 5 % of `mbps`. Return the last coarseness.

    Raises:
        UsageError: If no coarseness has that rate.
    """
    low, high, rate = -6.0, 8.0, 0.0
    for _ in range(TRIALS):
        octave = (low + high) / 2
        rate = write(2.0**octave)
        if abs(rate / mbps - 1) <= 0.05:
            return 2.0**octave
        low, high = (octave, high) if rate > mbps else (low, octave)
    raise UsageError(
        f"{mbps:g} Mbit/s cannot be reached: the nearest trial has {rate:.3g}. Choose another rate, or train more or fewer points."
    )
