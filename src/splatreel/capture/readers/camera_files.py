"""Cameras without images, of a calibration file or a transforms.json."""

from __future__ import annotations

from pathlib import Path

from splatreel.base.errors import CaptureError
from splatreel.capture.lens import undistorted_camera
from splatreel.capture.readers.calibrated import read_rig
from splatreel.capture.readers.calibrations.calibrated_rig import Rig, RigCamera
from splatreel.capture.readers.transforms import META, TRAIN, read_transforms
from splatreel.scene.camera import Camera


def read_camera_file(path: Path) -> list[Camera] | None:
    """Return the cameras of a calibration file of another program, without their distortion.

    Args:
        path: File of a format that captures may have.

    Returns:
        None if the format is unknown.

    Raises:
        CaptureError: The file cannot be used, or does not state the size of the images.
    """
    rig = read_transforms(path) if path.name in (META, TRAIN) else read_rig(path)
    return None if rig is None else [_camera(rig, camera) for camera in rig.cameras]


def _camera(rig: Rig, camera: RigCamera) -> Camera:
    if camera.size is None:
        raise CaptureError(
            f"{rig.origin}: does not state the size of the images of camera {camera.name}. Name the folder that also holds its images."
        )
    whose = f"{rig.origin}: camera {camera.name}"
    return undistorted_camera(camera.name, camera.viewmat, camera.lens(*camera.size), *camera.size, whose)[0]
