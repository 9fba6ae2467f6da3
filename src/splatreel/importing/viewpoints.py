"""Viewpoints of a sequence: its training cameras, or a ring of cameras around it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import is_number, numbers, read_json
from splatreel.capture.lens import undistorted_camera
from splatreel.capture.opening import open_capture
from splatreel.capture.pose_checks import check_camera
from splatreel.capture.readers.calibrated import read_rig
from splatreel.capture.readers.calibrations.calibrated_rig import Rig, RigCamera
from splatreel.capture.readers.colmap import is_model_alone, model_views
from splatreel.capture.readers.transforms import META, TRAIN, read_transforms
from splatreel.scene.camera import Camera, facing
from splatreel.scene.gaussians import Gaussians


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
    return None if rig is None else [_calibrated_camera(rig, camera) for camera in rig.cameras]


def _calibrated_camera(rig: Rig, camera: RigCamera) -> Camera:
    if camera.size is None:
        raise CaptureError(
            f"{rig.origin}: does not state the size of the images of camera {camera.name}. Name the folder that also holds its images."
        )
    whose = f"{rig.origin}: camera {camera.name}"
    return undistorted_camera(camera.name, camera.viewmat, camera.lens(*camera.size), *camera.size, whose)[0]


RING, WIDTH, HEIGHT = 12, 960, 540
"""Number of cameras of a ring, and their size in pixels."""
MOST_CAMERAS, MOST_PIXELS = 10_000, 1 << 20
"""Maximum number of cameras in a file, and of pixels across an image."""
FIELD_OF_VIEW, ABOVE = 50.0, 15.0
"""Horizontal field of view of a ring camera, and its downward angle, in degrees."""
DOME = (0.0, 25.0, 50.0)
"""Downward angles of the rings of a dome, in degrees."""
SHOWS = 0.1
"""Minimum opacity of points that locate the scene."""


def read_cameras(path: str | Path, origin: np.ndarray | None = None) -> list[Camera]:
    """Return the cameras of a cameras.json of 3DGS, a folder with one, a calibration file, a capture or a COLMAP model alone.

    Args:
        path: File or folder.
        origin: Point subtracted from all positions before rounding to float32, [3] float64; None subtracts nothing.

    Raises:
        CaptureError: The file is invalid. The message names it.
    """
    place = Path(path)
    file = place / "cameras.json" if place.is_dir() else place
    if not file.is_file():
        if is_model_alone(place):
            return [_shifted(camera, origin) for camera in model_views(place)]
        capture = open_capture(place)
        capture.close()
        return [_shifted(camera, origin) for camera in capture.cameras]
    if (calibrated := read_camera_file(file)) is not None:
        return [_shifted(camera, origin) for camera in calibrated]
    document = read_json(file, CaptureError)
    try:
        if not isinstance(document, list) or len(document) > MOST_CAMERAS:
            raise ValueError(f"expected a list of up to {MOST_CAMERAS} cameras")
        cameras = [_camera(entry, index, file, origin) for index, entry in enumerate(document)]
    except (ValueError, TypeError, KeyError) as error:
        raise CaptureError(
            f"{file}: is not a cameras.json as 3DGS writes it ({type(error).__name__}: {error})."
        ) from error
    if not cameras:
        raise CaptureError(f"{file}: holds no camera.")
    return cameras


def _shifted(camera: Camera, origin: np.ndarray | None) -> Camera:
    if origin is None:
        return camera
    viewmat = camera.viewmat.astype(np.float64)
    viewmat[:3, 3] += viewmat[:3, :3] @ origin
    return replace(camera, viewmat=viewmat)


def _camera(entry: dict[str, Any], index: int, file: Path, origin: np.ndarray | None) -> Camera:
    """Parse a camera: center `position`, camera-to-world `rotation` [3, 3], fx and fy in pixels, central principal point."""
    if not all(is_number(entry[name]) for name in ("width", "height", "fx", "fy")):
        raise ValueError(f"width, height, fx or fy of camera {index} is not a number")
    width, height = int(entry["width"]), int(entry["height"])
    turn = numbers(entry["rotation"], 3, 3).T
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = (
        turn,
        -turn @ (numbers(entry["position"], 3) - (0.0 if origin is None else origin)),
    )
    K = np.array([[entry["fx"], 0, width / 2], [0, entry["fy"], height / 2], [0, 0, 1]], np.float64)
    if not (min(width, height) >= 1 and max(width, height) <= MOST_PIXELS) or min(K[0, 0], K[1, 1]) <= 0:
        raise ValueError(f"camera {index} has no size, more than {MOST_PIXELS} pixels across, or no focal length")
    name = entry.get("img_name", index)
    camera = Camera(name if isinstance(name, str) else str(index), viewmat, K, width, height)
    check_camera(camera, str(file))
    return camera


def visible_positions(points: Gaussians) -> np.ndarray:
    """Return the positions [P, 3] float64 of visible points, or of all points if none is visible."""
    seen = points.opacities >= SHOWS
    return (points.means[seen] if seen.any() else points.means).astype(np.float64)


def ring(points: Gaussians, up: np.ndarray, above: float = ABOVE, name: str = "view") -> list[Camera]:
    """Return cameras around the visible points, looking at their median from slightly above.

    The first camera looks along the world's z axis, or its x axis if z is up.

    Args:
        points: Gaussians to look at.
        up: Unit up direction, [3].
        above: Downward angle of the cameras, degrees.
        name: Start of their names.
    """
    places = visible_positions(points)
    middle = np.median(places, axis=0)
    radius = max(float(np.quantile(np.linalg.norm(places - middle, axis=1), 0.9)), 1e-6)
    distance = radius / math.sin(math.radians(FIELD_OF_VIEW / 2) * HEIGHT / WIDTH)
    axis = np.array([0.0, 0.0, 1.0]) if abs(up[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    ahead = axis - (axis @ up) * up
    ahead /= np.linalg.norm(ahead)
    aside = np.cross(ahead, up)
    focal = WIDTH / 2 / math.tan(math.radians(FIELD_OF_VIEW / 2))
    cameras = []
    for k in range(RING):
        turn, down = 2 * math.pi * k / RING, math.radians(above)
        level = math.cos(turn) * ahead + math.sin(turn) * aside
        forward = math.cos(down) * level - math.sin(down) * up
        cameras.append(facing(f"{name}{k:02}", middle - distance * forward, forward, focal, WIDTH, HEIGHT, up))
    return cameras


def dome(points: Gaussians, up: np.ndarray) -> list[Camera]:
    """Return rings of cameras around the visible points at several heights. Arguments are those of `ring`."""
    return [camera for above in DOME for camera in ring(points, up, above, f"view{above:.0f}-")]
