"""Retention of a live run: renewal of static layers, and deletion of old groups.

At each epoch all static layers retire together, and their living points are written again. Without this renewal, a late viewer
would have to download every static Gaussian ever created. Groups outside the retention window are deleted from the reel and the
checkpoints.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatreel.codec.writer import ReelWriter
from splatreel.method.cameras.rig import Rig
from splatreel.run import checkpoint
from splatreel.run.store import Store
from splatreel.scene.gaussians import Gaussians, StaticPoints

EPOCH = 64
"""Groups per epoch. Each epoch starts with a renewal."""


def starts_epoch(group: int) -> bool:
    """Return whether all earlier layers retire at a group."""
    return group > 0 and group % EPOCH == 0


def retirement_group(group: int) -> int:
    """Return the group at which the layers born at a group retire."""
    return (group // EPOCH + 1) * EPOCH


def save_epochs(store: Store, group: int) -> None:
    """Save the first groups of all epochs up to a group, for readers of the checkpoints."""
    store.save_chapter_firsts(list(range(0, retirement_group(group) + 1, EPOCH)))


def trained_points(store: Store, group: int) -> Gaussians:
    """Return all static points at the end of a group, as trained.

    Renewal encodes these, since coding decoded points again would lose quality each time.
    """
    return Gaussians.concatenate([Gaussians.empty(0), *(layer.trained for _, layer in store.layers(group))])


def static_before(store: Store, group: int, sh_degree: int) -> StaticPoints:
    """Return the static points at the start of a group, all alive."""
    if group == 0 or starts_epoch(group):
        return StaticPoints.none(sh_degree)
    return StaticPoints.none(sh_degree).with_layer(store.static(group - 1))


class Window:
    """Window of the groups that are kept.

    The state of the cameras at the first kept group is saved before anything is deleted. Static layers are kept as long as a
    kept group shows them.

    Attributes:
        store: Checkpoints.
        frames: Number of frames that are kept; None keeps all.
    """

    def __init__(self, store: Store, frames: int | None) -> None:
        """Create a window, see the attributes."""
        self.store = store
        self.frames = frames
        self._rigs: deque[tuple[int, Rig]] = deque()

    def record_rig(self, group: int, rig: Rig) -> None:
        """Record the rig at the start of a group."""
        if self.frames is not None:
            self._rigs.append((group, rig))

    def drop_old_groups(self, writer: ReelWriter) -> None:
        """Delete groups outside the window, after a group was written."""
        manifest = writer.manifest
        if self.frames is None or not manifest.groups:
            return
        oldest = manifest.frames - self.frames
        first = next(entry.group for entry in manifest.groups if entry.end > oldest)
        writer.drop_before(first)
        self.drop_before(writer.manifest.first_group)

    def drop_before(self, first: int) -> None:
        """Delete the checkpoints of earlier groups, except for layers that later groups show."""
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
    """Delete the checkpoints of a group except for the named files. The poses in group 0 are kept too."""
    kept = kept | {"poses.safetensors"} if group == 0 else kept
    for file in folder.glob("*"):
        if file.name not in kept:
            file.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()


def first_kept(store: Store) -> int:
    """Return the first group whose checkpoints are kept."""
    path = _file(store)
    return int(checkpoint.load_arrays(path)["group"][0]) if path.exists() else 0


def save_rig(store: Store, group: int, rig: Rig) -> None:
    """Save the cameras' state at the start of a group, so that no earlier group is needed."""
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
    """Return the rig at the first kept group. rig: initial rig without excluded cameras."""
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
