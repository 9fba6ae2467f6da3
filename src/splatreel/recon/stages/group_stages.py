"""The list of all stages of a group, in the order in which they are executed."""

from __future__ import annotations

from typing import Any

from splatreel.recon.cameras.rig import Rig
from splatreel.recon.run.store import GroupStore
from splatreel.recon.stages.camera_stages import CheckPoses, EvenExposures
from splatreel.recon.stages.keyframe_stages import ChapterKeyframe, FirstKeyframe, LaterKeyframe
from splatreel.recon.stages.motion_stages import Layering, Motion, Tracking
from splatreel.recon.stages.stage import Stage
from splatreel.recon.stages.write_stages import WriteGroup, WriteLayer

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
