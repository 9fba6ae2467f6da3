"""The list of all stages of a group, in the order in which they are executed."""

from __future__ import annotations

from typing import Any

from splatreel.method.cameras.rig import Rig
from splatreel.run.stages.camera_stages import CheckPoses, EvenExposures
from splatreel.run.stages.keyframe_stages import ChapterKeyframe, FirstKeyframe, LaterKeyframe
from splatreel.run.stages.motion_stages import Layering, Motion, Tracking
from splatreel.run.stages.stage import Stage
from splatreel.run.stages.write_stages import WriteGroup, WriteLayer
from splatreel.run.store import GroupStore

GROUP_STAGES: tuple[Stage[Any], ...] = (
    EvenExposures(),
    CheckPoses(),
    FirstKeyframe(),
    ChapterKeyframe(),
    LaterKeyframe(),
    Layering(),
    WriteLayer(),
    Tracking(),
    Motion(),
    WriteGroup(),
)


def restored_rig(rig: Rig, store: GroupStore, own: int) -> Rig:
    """Return the cameras after a finished group.

    Args:
        rig: Cameras as the group found them.
        store: Checkpoints of the group.
        own: Number of frames of the group without the overlap.
    """
    for stage in sorted(GROUP_STAGES, key=lambda stage: stage.name != CheckPoses.name):  # poses may leave cameras out
        rig = stage.restore_rig(rig, store, own)
    return rig
