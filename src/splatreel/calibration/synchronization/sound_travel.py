"""Time that sound takes to the cameras, by which alignment by sound is off."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.base.errors import SplatreelError
from splatreel.calibration.calibration_record import is_in_meters
from splatreel.capture.pose_checks import MOST, meeting_point
from splatreel.capture.readers.calibrated import IN_METERS, is_calibrated, read_calibration
from splatreel.capture.readers.colmap import is_colmap, model_views
from splatreel.scene.camera import Camera

SPEED = 343.0
"""Speed of sound in meters per second, in dry air of 20 degrees."""
EXAMPLE = 10.0
"""Meters of the example in `describe_unknown_travel`."""


@dataclass(frozen=True)
class SoundTravel:
    """Time that sound takes from the place that the cameras look at.

    Attributes:
        seconds: Time by camera.
        most: Maximum difference between two cameras for a sound anywhere, in seconds.
    """

    seconds: dict[str, float]
    most: float

    def describe(self) -> str:
        """Return a sentence about the correction."""
        near, far = min(self.seconds.values()), max(self.seconds.values())
        return (
            f"sound takes {1000 / SPEED:.1f} ms a meter. This is corrected, by up to {1000 * (far - near):.1f} ms, for a sound at the "
            f"place that the cameras look at, {SPEED * near:.1f} to {SPEED * far:.1f} m away. A sound elsewhere shifts two cameras by "
            f"up to {1000 * self.most:.0f} ms"
        )


def describe_unknown_travel(frame: float) -> str:
    """Return a sentence about what the time that sound takes may amount to. `frame` is the duration of a frame in seconds."""
    late = EXAMPLE / SPEED
    return (
        f"sound takes {1000 / SPEED:.1f} ms a meter. This is not corrected, since the places of the cameras are not known in meters: a "
        f"camera {EXAMPLE:g} m farther from the sound than others seems {1000 * late:.0f} ms ({late / frame:.1f} frames) late. "
        f"Calibrate in meters (--board, --scale-board or --distance) and run this again, or leave it to `reconstruct`, which learns up "
        f"to 1.5 frames for each camera"
    )


def sound_travel(path: Path, names: Iterable[str]) -> SoundTravel | None:
    """Return the time that sound takes to some cameras; None if a place is unknown, or not in meters, or the cameras look nowhere."""
    try:
        cameras = {camera.name: camera for camera in _metric_cameras(path)}
    except SplatreelError:  # `capture check` reports what is wrong with the poses
        return None
    if not cameras or any(name not in cameras for name in names):
        return None
    meeting = meeting_point(list(cameras.values()))
    if meeting is None or meeting.before <= MOST:
        return None
    seconds = dict(zip(cameras, (meeting.distances / SPEED).tolist(), strict=True))
    centers = np.stack([cameras[name].center for name in names])
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=-1).max()
    return SoundTravel({name: seconds[name] for name in names}, float(apart) / SPEED)


def _metric_cameras(path: Path) -> list[Camera]:
    """Return the cameras of a capture whose unit is a meter; none of another capture."""
    if is_colmap(path):
        return model_views(path) if is_in_meters(path) else []
    if not is_calibrated(path):
        return []
    layout, rig = read_calibration(path)
    lens = np.array([[1.0, 0, 1], [0, 1, 1], [0, 0, 1]])
    return [Camera(view.name, view.viewmat, lens, 2, 2) for view in rig.cameras] if layout in IN_METERS else []
