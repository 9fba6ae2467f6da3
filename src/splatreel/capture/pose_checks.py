"""Plausibility checks of poses: world to camera in OpenCV's axes, with valid lenses.

Matrices that are not rotations or that mirror are refused. A matrix alone does not show whether it is inverted. Sparse
points must be in front of the cameras. Without points only doubts are reported, because a rig may face outwards. Images
then decide (`method/cameras/poses.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.scene.camera import Camera

NEEDED = "Needed are matrices of world to camera, in OpenCV's axes: x right, y down, z forward"
UNIT = 1e-2
"""Maximum deviation of the products of a rotation's axes from those of orthonormal axes."""
PARALLEL = 2.0
"""Root mean square angle in degrees between axes for them to meet in a point."""
MEET, MISS = 0.25, 0.45
"""Sine of the median angle between an axis and the direction to the meeting point: maximum if axes meet, minimum if they do not."""
NO_WAY = 1e-3
"""A camera is at the meeting point if it is closer than this share of the larger distance, of the given and the inverted poses."""
MOST = 0.8
"""Share of cameras that must agree before a doubt is reported, and of points behind cameras for a refusal."""
HARDLY = 0.02
"""Minimum share of the points that a camera shows if the poses fit."""
OFF_CENTER = 0.1
"""Minimum distance of a principal point from the border, as a share of the image's width and height."""
ENOUGH_CAMERAS, ENOUGH_POINTS = 4, 20


def check_rotation(rotation: np.ndarray, origin: str) -> None:
    """Raise `CaptureError` for a matrix [3, 3] that is not a rotation. `origin` starts the message."""
    rotation = np.asarray(rotation, np.float64)
    products, lengths = rotation @ rotation.T, np.linalg.norm(rotation, axis=1)
    if np.abs(products - np.eye(3)).max() > UNIT:
        scaled = np.abs(products / max(lengths[0], 1e-30) ** 2 - np.eye(3)).max() <= UNIT
        remedy = f"Divide its 3x3 part by {lengths[0]:.6g}" if scaled else "Export the poses again"
        raise CaptureError(
            f"{origin} is {rotation.round(4).tolist()}, no rotation: its axes must be at right angles and 1 long, they are "
            f"{', '.join(f'{length:.4g}' for length in lengths)} long. {NEEDED}. {remedy}."
        )
    if np.linalg.det(rotation) < 0:
        raise CaptureError(
            f"{origin} is {rotation.round(4).tolist()}, no rotation: it mirrors (its determinant is -1), which no camera does. "
            f"{NEEDED}. Flip the wrong axis, or export the poses again."
        )


def check_center(K: np.ndarray, size: tuple[int, int], origin: str, remedy: str) -> None:
    """Raise `CaptureError` if K is for images of another size, as its principal point shows.

    Args:
        K: Matrix [3, 3] in pixels, from a file that does not state the size.
        size: Width and height of the images.
        origin: File and camera, which start the message.
        remedy: End of the message.
    """
    x, y = K[0, 2] / size[0], K[1, 2] / size[1]
    if not (OFF_CENTER < x < 1 - OFF_CENTER and OFF_CENTER < y < 1 - OFF_CENTER):
        raise CaptureError(
            f"{origin} has the principal point {K[0, 2]:.6g}, {K[1, 2]:.6g}, far from the center of images of {size[0]}x{size[1]}: it "
            f"is for images of another size. {remedy}."
        )


def check_camera(camera: Camera, origin: str) -> None:
    """Raise `CaptureError` for matrices that are not a pinhole camera's. `origin` is the file."""
    whose = f"{origin}: camera {camera.name!r}"
    check_rotation(camera.viewmat[:3, :3], f"{whose}: the 3x3 part of its pose")
    if np.abs(camera.viewmat[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise CaptureError(f"{whose}: the last row of the pose is {camera.viewmat[3].tolist()}, expected 0, 0, 0, 1.")
    K = camera.K
    if (
        min(K[0, 0], K[1, 1]) <= 0
        or np.abs(K[2] - [0, 0, 1]).max() > 1e-6
        or max(abs(K[0, 1]), abs(K[1, 0])) > UNIT * K[0, 0]
    ):
        raise CaptureError(
            f"{whose}: K is {K.tolist()}, expected fx, 0, cx; 0, fy, cy; 0, 0, 1 in pixels with fx and fy above 0. Correct it."
        )


def validate_poses(cameras: list[Camera], points: np.ndarray | None, origin: str) -> list[str]:
    """Return sentences about doubtful poses of a rig.

    Args:
        cameras: All cameras.
        points: Visible sparse points, [P, 3], or None.
        origin: File of the poses, for messages.

    Raises:
        CaptureError: A matrix is invalid, or most cameras have the points behind them.
    """
    for camera in cameras:
        check_camera(camera, origin)
    if points is not None and len(points) >= ENOUGH_POINTS:
        shown, behind = _visible_share(cameras, points), float((_depths(cameras, points) < 0).mean())
        inverse = shown < HARDLY and _visible_share(inverted(cameras), points) > 1 - MOST
        if inverse or behind > MOST:
            remedy = " Inverted, they show them: they are camera to world." if inverse else ""
            raise CaptureError(
                f"{origin}: the poses do not fit the capture's points: a camera shows {shown:.0%} of them, and has {behind:.0%} behind "
                f"it.{remedy} {NEEDED}."
            )
        return []
    return _doubts(cameras, origin)


def inverted(cameras: list[Camera]) -> list[Camera]:
    """Return the cameras with inverted poses, as if they were camera to world."""
    return [_with(camera, np.linalg.inv(camera.viewmat.astype(np.float64))) for camera in cameras]


def with_opengl_axes(cameras: list[Camera]) -> list[Camera]:
    """Return the cameras with OpenGL's axes: y up and z backwards."""
    return [_with(camera, np.diag([1.0, -1, -1, 1]) @ camera.viewmat.astype(np.float64)) for camera in cameras]


def _with(camera: Camera, viewmat: np.ndarray) -> Camera:
    return Camera(camera.name, viewmat, camera.K, camera.width, camera.height)


def _doubts(cameras: list[Camera], origin: str) -> list[str]:
    if look_inverted(cameras):
        return [
            f"{origin}: the cameras look past each other as their poses are said to be, and at one place where each is inverted: they "
            f"may be camera to world. {NEEDED}."
        ]
    given, other = meeting_point(cameras), meeting_point(inverted(cameras))
    if len(cameras) < ENOUGH_CAMERAS or given is None:
        return []
    if given.before < 1 - MOST and given.miss(_shortest(given, other)) < MEET:
        return [
            f"{origin}: the cameras look away from each other. That is right where they film outwards; else their poses are inverted, "
            f"or of other axes. {NEEDED}."
        ]
    return []


def look_inverted(cameras: list[Camera]) -> bool:
    """Return True if the cameras look past each other with the given poses, and at one place with inverted ones."""
    given, other = meeting_point(cameras), meeting_point(inverted(cameras))
    if len(cameras) < ENOUGH_CAMERAS or given is None or other is None:
        return False
    shortest = _shortest(given, other)
    return given.miss(shortest) > MISS and other.before > MOST and other.miss(shortest) < MEET


def _shortest(given: Meeting, other: Meeting | None) -> float:
    """Return the distance within which a camera is at the meeting point."""
    return NO_WAY * max(given.distance, other.distance if other else 0.0)


@dataclass(frozen=True)
class Meeting:
    """Point where the cameras' axes come closest to each other, relative to each camera [C]."""

    depths: np.ndarray
    """Coordinate of the point along the axis."""
    past: np.ndarray
    """Distance of the point from the axis."""

    @property
    def before(self) -> float:
        """Share of cameras with the point in front of them."""
        return float((self.depths > 0).mean())

    @property
    def distances(self) -> np.ndarray:
        """Distances of the cameras from the point."""
        return np.hypot(self.depths, self.past)

    @property
    def distance(self) -> float:
        """Median distance of the cameras from the point."""
        return float(np.median(self.distances))

    def miss(self, shortest: float) -> float:
        """Return the sine of the median angle between an axis and the direction to the point.

        For a camera closer than `shortest` the direction is only rounding error, and it counts as a right angle.
        """
        floor = max(shortest, 1e-12)
        return float(np.median(np.hypot(self.past, floor) / np.hypot(np.hypot(self.depths, self.past), floor)))


def meeting_point(cameras: list[Camera]) -> Meeting | None:
    """Return the least-squares meeting point of the axes, or None if they are parallel."""
    centers = np.stack([camera.center for camera in cameras]).astype(np.float64)
    forwards = np.stack([camera.forward for camera in cameras]).astype(np.float64)
    projectors = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
    mean = projectors.mean(0)
    if np.linalg.eigvalsh(mean)[0] < np.sin(np.radians(PARALLEL)) ** 2:
        return None
    place = np.linalg.solve(mean, np.einsum("nij,nj->i", projectors, centers) / len(cameras))
    depths = ((place - centers) * forwards).sum(1)
    return Meeting(depths, np.linalg.norm(np.einsum("nij,nj->ni", projectors, place - centers), axis=1))


def _depths(cameras: list[Camera], points: np.ndarray) -> np.ndarray:
    """Return the depths [C, P] of points [P, 3] along the cameras' axes."""
    rows = np.stack([camera.viewmat[2] for camera in cameras]).astype(np.float64)
    return rows[:, :3] @ points.T.astype(np.float64) + rows[:, 3:]


def _visible_share(cameras: list[Camera], points: np.ndarray) -> float:
    """Return the share of points [P, 3] within a camera's image, median over the cameras."""
    shares = []
    for camera in cameras:
        x, y, depth = camera.K.astype(np.float64) @ (camera.viewmat[:3, :3] @ points.T + camera.viewmat[:3, 3:])
        inside = (depth > 0) & (x > 0) & (x < camera.width * depth) & (y > 0) & (y < camera.height * depth)
        shares.append(float(inside.mean()))
    return float(np.median(shares))
