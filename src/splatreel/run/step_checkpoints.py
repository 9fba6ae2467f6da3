"""Checkpoints of the steps of a group: the names of the files and of their arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from splatreel.method.cameras.exposure import Exposure, at_next_keyframe
from splatreel.method.cameras.rig import Poses, Rig
from splatreel.method.layering.labels import Layers, RelitPoints
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.keyframe_trainer import KeyframeResult
from splatreel.run.checkpoint import Arrays, pack, present, unpack
from splatreel.run.store import GroupStore

Found = TypeVar("Found")


@dataclass(frozen=True)
class StepCheckpoint(Generic[Found]):
    """File that holds the result of a step.

    Attributes:
        name: Name of the file without its suffix.
        to_arrays: Returns a result as arrays.
        from_arrays: Returns the result that `to_arrays` gave these arrays for.
    """

    name: str
    to_arrays: Callable[[Found], Arrays]
    from_arrays: Callable[[Arrays], Found]

    def load(self, store: GroupStore) -> Found | None:
        """Return the saved result; None where there is none."""
        arrays = store.load(self.name)
        return None if arrays is None else self.from_arrays(arrays)

    def save(self, store: GroupStore, found: Found) -> None:
        """Save a result."""
        store.save(self.name, self.to_arrays(found))


def _pack_keyframe(found: KeyframeResult) -> Arrays:
    return pack(found.points) | {"gains": found.gains} | present(alive=found.alive)


def _unpack_keyframe(arrays: Arrays) -> KeyframeResult:
    return KeyframeResult(unpack(arrays), arrays["gains"], arrays.get("alive"))


def _pack_layers(found: Layers) -> Arrays:
    arrays = {"alive": found.alive, "light": found.relit.light}
    kinds = {"settled": found.new_static, "dynamic": found.dynamic, "relit": found.relit.points}
    for kind, points in kinds.items():
        arrays |= pack(points, f"{kind}_")
    return arrays


def _unpack_layers(arrays: Arrays) -> Layers:
    new_static, dynamic, relit = (unpack(arrays, f"{kind}_") for kind in ("settled", "dynamic", "relit"))
    return Layers(arrays["alive"], new_static, dynamic, RelitPoints(relit, arrays["light"]))


def _pack_tracks(found: GroupStart) -> Arrays:
    return pack(found.dynamic) | present(tracks=found.tracks, shades=found.shades, left=found.departed)


def _unpack_tracks(arrays: Arrays) -> GroupStart:
    return GroupStart(unpack(arrays), arrays.get("tracks"), arrays.get("shades"), arrays.get("left"))


EXPOSURE = StepCheckpoint[Exposure](
    "exposure",
    lambda found: {"change": found.change, "light": found.light},
    lambda arrays: Exposure(arrays["change"], arrays["light"]),
)
POSES = StepCheckpoint[Poses](
    "poses",
    lambda found: {"viewmats": found.viewmats} | present(kept=found.kept),
    lambda arrays: Poses(arrays["viewmats"], arrays.get("kept")),
)
"""Poses of a group. Those of the first group are found before it begins, and may leave cameras out."""
KEYFRAME = StepCheckpoint[KeyframeResult]("keyframe", _pack_keyframe, _unpack_keyframe)
CHAPTER = StepCheckpoint[KeyframeResult]("chapter", _pack_keyframe, _unpack_keyframe)
"""First keyframe of a chapter."""
LAYERS = StepCheckpoint[Layers]("layering", _pack_layers, _unpack_layers)
TRACKS = StepCheckpoint[GroupStart]("tracking", _pack_tracks, _unpack_tracks)
TIME_OFFSETS = StepCheckpoint[np.ndarray]("delays", lambda found: {"delays": found}, lambda arrays: arrays["delays"])
"""Time offsets [C] of the cameras at the end of a group."""


def restored_rig(rig: Rig, store: GroupStore, own: int) -> Rig:
    """Return the cameras after a finished group.

    Args:
        rig: Cameras as the group found them.
        store: Checkpoints of the group.
        own: Number of frames of the group without the overlap.
    """
    poses, exposure, offsets = POSES.load(store), EXPOSURE.load(store), TIME_OFFSETS.load(store)
    keyframe = KEYFRAME.load(store) or CHAPTER.load(store)
    rig = rig if poses is None else rig.with_poses(poses)  # comes first, because it may leave cameras out
    rig = rig if exposure is None else at_next_keyframe(rig, exposure, own)
    rig = rig if keyframe is None else replace(rig, gains=keyframe.gains)
    return rig if offsets is None else rig.with_offsets(offsets)
