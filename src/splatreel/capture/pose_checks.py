"""Whether cameras can be what a capture's files say: world to camera in OpenCV's axes, with lenses that show something.

A matrix that is no rotation, or that mirrors, is refused. Of which way it goes the matrix alone does not tell: the sparse points, where
there are any, must lie before the cameras; without them only doubts can be had, for a rig may film outwards. Pictures decide then
(`recon/cameras/readings.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.errors import CaptureError
from splatreel.scene.camera import Camera

NEEDED = "Needed are matrices of world to camera, in OpenCV's axes: x right, y down, z forward"
UNIT = 1e-2
"""How far products of a rotation's axes may be off those of unit axes at right angles."""
PARALLEL = 2.0
"""Degrees that axes must be apart, as a root mean square, for them to meet somewhere."""
MEET, MISS = 0.25, 0.45
"""Sines of the median angle between a camera's axis and the way to where the axes meet: at most, if they do; at least, if not."""
NO_WAY = 1e-3
"""A camera stands where the axes meet if it is closer than this share of the larger distance, of the poses as given and inverted."""
MOST = 0.8
"""Share of the cameras that must agree before a doubt is uttered, and of the points that must be behind them for a refusal."""
HARDLY = 0.02
"""Share of the points that a camera of a rig that fits them shows, at least."""
ENOUGH_CAMERAS, ENOUGH_POINTS = 4, 20


def check_rotation(rotation: np.ndarray, origin: str) -> None:
    """Raises `CaptureError` for a matrix [3, 3] that is no rotation. origin: the file, and whose it is."""
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
            f"{NEEDED}. Turn the axis round that is the wrong way, or export the poses again."
        )


def check_camera(camera: Camera, origin: str) -> None:
    """Raises `CaptureError` for a camera whose matrices are none of a pinhole camera's. origin: the file."""
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
    """What is doubtful about the poses of a rig, in sentences. points: [P, 3] that the cameras see, if any. origin: the file.

    Raises `CaptureError` for matrices that cannot be a camera's, and for points that most cameras have behind them.
    """
    for camera in cameras:
        check_camera(camera, origin)
    if points is not None and len(points) >= ENOUGH_POINTS:
        shown, behind = _shown(cameras, points), float((_depths(cameras, points) < 0).mean())
        inverse = shown < HARDLY and _shown(inverted(cameras), points) > 1 - MOST
        if inverse or behind > MOST:
            remedy = " Inverted, they show them: they are camera to world." if inverse else ""
            raise CaptureError(
                f"{origin}: the poses do not fit the capture's points: a camera shows {shown:.0%} of them, and has {behind:.0%} behind "
                f"it.{remedy} {NEEDED}."
            )
        return []
    return _doubts(cameras, origin)


def inverted(cameras: list[Camera]) -> list[Camera]:
    """As if the poses were camera to world."""
    return [_with(camera, np.linalg.inv(camera.viewmat.astype(np.float64))) for camera in cameras]


def turned_about(cameras: list[Camera]) -> list[Camera]:
    """As if the cameras' axes were OpenGL's: y up and z backwards."""
    return [_with(camera, np.diag([1.0, -1, -1, 1]) @ camera.viewmat.astype(np.float64)) for camera in cameras]


def _with(camera: Camera, viewmat: np.ndarray) -> Camera:
    return Camera(camera.name, viewmat, camera.K, camera.width, camera.height)


def _doubts(cameras: list[Camera], origin: str) -> list[str]:
    """Return what the place where the cameras' axes meet, if they do, makes doubtful."""
    given, other = _meeting(cameras), _meeting(inverted(cameras))
    if len(cameras) < ENOUGH_CAMERAS or given is None:
        return []
    shortest = NO_WAY * max(given.distance, other.distance if other else 0.0)
    miss = given.miss(shortest)
    if miss > MISS and other is not None and other.before > MOST and other.miss(shortest) < MEET:
        return [
            f"{origin}: the cameras look past each other as their poses are said to be, and at one place where each is inverted: they "
            f"may be camera to world. {NEEDED}."
        ]
    if given.before < 1 - MOST and miss < MEET:
        return [
            f"{origin}: the cameras look away from each other. That is right where they film outwards; else their poses are inverted, "
            f"or of other axes. {NEEDED}."
        ]
    return []


@dataclass(frozen=True)
class _Meeting:
    """Where the cameras' axes come closest to each other, as each camera [C] sees that place."""

    depths: np.ndarray
    """Its coordinate along the axis."""
    past: np.ndarray
    """How far the axis passes it by."""

    @property
    def before(self) -> float:
        """Share of the cameras that have it before them."""
        return float((self.depths > 0).mean())

    @property
    def distance(self) -> float:
        """From the cameras, in the median."""
        return float(np.median(np.hypot(self.depths, self.past)))

    def miss(self, shortest: float) -> float:
        """Return the sine of the median angle between an axis and the way to the place.

        A camera closer to it than `shortest` counts as if its axis were at right angles to that way, whose direction is only rounding.
        """
        floor = max(shortest, 1e-12)
        return float(np.median(np.hypot(self.past, floor) / np.hypot(np.hypot(self.depths, self.past), floor)))


def _meeting(cameras: list[Camera]) -> _Meeting | None:
    """Return where the axes meet, by least squares, or None if they are parallel."""
    centers = np.stack([camera.center for camera in cameras]).astype(np.float64)
    forwards = np.stack([camera.forward for camera in cameras]).astype(np.float64)
    projectors = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
    mean = projectors.mean(0)
    if np.linalg.eigvalsh(mean)[0] < np.sin(np.radians(PARALLEL)) ** 2:
        return None
    place = np.linalg.solve(mean, np.einsum("nij,nj->i", projectors, centers) / len(cameras))
    depths = ((place - centers) * forwards).sum(1)
    return _Meeting(depths, np.linalg.norm(np.einsum("nij,nj->ni", projectors, place - centers), axis=1))


def _depths(cameras: list[Camera], points: np.ndarray) -> np.ndarray:
    """[C, P] of points [P, 3] along the cameras' axes."""
    rows = np.stack([camera.viewmat[2] for camera in cameras]).astype(np.float64)
    return rows[:, :3] @ points.T.astype(np.float64) + rows[:, 3:]


def _shown(cameras: list[Camera], points: np.ndarray) -> float:
    """Share of points [P, 3] that are in a camera's picture, median of the cameras."""
    shares = []
    for camera in cameras:
        x, y, depth = camera.K.astype(np.float64) @ (camera.viewmat[:3, :3] @ points.T + camera.viewmat[:3, 3:])
        inside = (depth > 0) & (x > 0) & (x < camera.width * depth) & (y > 0) & (y < camera.height * depth)
        shares.append(float(inside.mean()))
    return float(np.median(shares))
