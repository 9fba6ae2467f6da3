"""The retention window of a live run: groups that are shown no longer leave the reel and the checkpoints."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatreel.codec.writer import ReelWriter
from splatreel.recon.cameras.rig import Rig
from splatreel.recon.live.renewal import EPOCH
from splatreel.recon.run import checkpoint
from splatreel.recon.run.store import Store


class Window:
    """Keeps the last groups that show `frames` frames, and what continuing needs.

    What is known of the cameras as the first of them begins is written before anything is deleted; static points go with the last
    group that shows them. frames: None keeps all.
    """

    def __init__(self, store: Store, frames: int | None) -> None:
        self.store, self.frames = store, frames
        self._rigs: deque[tuple[int, Rig]] = deque()

    def begins(self, group: int, rig: Rig) -> None:
        """A group begins. rig: as it finds it."""
        if self.frames is not None:
            self._rigs.append((group, rig))

    def move(self, writer: ReelWriter) -> None:
        """Drop what is too old, after a group was published."""
        manifest = writer.manifest
        if self.frames is None or not manifest.groups:
            return
        oldest = manifest.frames - self.frames
        first = next(entry.group for entry in manifest.groups if entry.end > oldest)
        writer.drop_before(first)
        self.drop_before(writer.manifest.first_group)

    def drop_before(self, first: int) -> None:
        """Delete the checkpoints of earlier groups, but for the layers that later ones show."""
        while self._rigs and self._rigs[0][0] < first:
            self._rigs.popleft()
        if first <= first_kept(self.store) or not self._rigs:
            return
        save_rig(self.store, first, self._rigs[0][1])
        epoch = first // EPOCH * EPOCH
        for folder in self.store.work.glob("group[0-9]*"):
            group = int(folder.name.removeprefix("group"))
            if group < first:
                _empty(folder, {"layer.safetensors"} if group >= epoch else set(), group)


def _empty(folder: Path, kept: set[str], group: int) -> None:
    """Delete the checkpoints of a group, but for those of these names; of the first group what it says of the cameras stays."""
    kept = kept | {"poses.safetensors"} if group == 0 else kept
    for file in folder.glob("*"):
        if file.name not in kept:
            file.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()


def first_kept(store: Store) -> int:
    """The first group whose checkpoints are kept."""
    path = _file(store)
    return int(checkpoint.load_arrays(path)["group"][0]) if path.exists() else 0


def save_rig(store: Store, group: int, rig: Rig) -> None:
    """What a group finds of the cameras, so that nothing before it is needed."""
    ends = np.stack(rig.ends) if rig.ends else np.zeros((0, len(rig.cameras)))
    arrays = {
        "group": np.array([group]),
        "gains": rig.gains,
        "exposure": rig.exposure,
        "light": rig.light,
        "ends": ends,
    }
    checkpoint.save_arrays(_file(store), arrays | {"viewmats": np.stack([camera.viewmat for camera in rig.cameras])})


def load_rig(store: Store, rig: Rig) -> Rig:
    """The rig at the first group that is kept. rig: as it is before the first group of all, without the cameras that were left out."""
    path = _file(store)
    if not path.exists():
        return rig
    arrays = checkpoint.load_arrays(path)
    pairs = zip(rig.cameras, arrays["viewmats"], strict=True)
    return replace(
        rig,
        cameras=[replace(camera, viewmat=viewmat) for camera, viewmat in pairs],
        gains=arrays["gains"],
        exposure=arrays["exposure"],
        light=arrays["light"],
        ends=tuple(arrays["ends"]),
    )


def _file(store: Store) -> Path:
    return store.work / "first.safetensors"
