"""Changes of a sequence while it is read: a shifted origin, another unit, a crop, and faint points left out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.importing.frames import Frames
from splatreel.importing.viewpoints import visible_positions
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

COARSE = 0.02
"""Largest spacing of float32 numbers at the positions of points, as a share of the points' typical scale."""


@dataclass(frozen=True)
class Edit:
    """Changes of all frames.

    Attributes:
        origin: Point of the sequence that becomes the origin, [3] float64.
        scale: Factor of all lengths.
        crop: Low and high corner of the box whose points are kept, [2, 3], in the sequence's coordinates; None keeps
            all.
        min_opacity: Points with a lower opacity are left out, 0..1.
    """

    origin: np.ndarray
    scale: float = 1.0
    crop: np.ndarray | None = None
    min_opacity: float = 0.0

    def camera(self, camera: Camera) -> Camera:
        """Return a camera of the sequence whose position was already shifted, in the changed coordinates."""
        viewmat = camera.viewmat.copy()
        viewmat[:3, 3] *= self.scale
        return replace(camera, viewmat=viewmat)


class EditedFrames:
    """Sequence with an edit applied to every frame."""

    def __init__(self, frames: Frames, edit: Edit) -> None:
        self.path = frames.path
        self.size = frames.size
        self.fps = frames.fps
        self.remarks = frames.remarks
        self._frames = frames
        self._edit = edit

    @property
    def antialias(self) -> bool:
        """True if the points are marked as trained with antialiasing."""
        return self._frames.antialias

    def __len__(self) -> int:
        return len(self._frames)

    def read(self, frame: int, origin: np.ndarray | None = None) -> Gaussians:
        """Return the Gaussians of a frame. `origin` is in the changed coordinates."""
        edit = self._edit
        shift = edit.origin + (0.0 if origin is None else np.asarray(origin, np.float64) / edit.scale)
        points = self._frames.read(frame, shift)
        kept = points.opacities >= edit.min_opacity
        if edit.crop is not None:
            low, high = edit.crop - shift
            kept &= ((points.means >= low) & (points.means <= high)).all(1)
        points = points if kept.all() else points[kept]
        return replace(points, means=points.means * edit.scale, scales=points.scales * edit.scale)


def edited(frames: Frames, edit: Edit) -> tuple[Frames, Edit]:
    """Return the changed sequence, and the changes with an origin near the points if they are far from the origin.

    Raises:
        GaussiansError: No frame holds points.
    """
    edit = replace(edit, origin=distant_origin(first_points(EditedFrames(frames, replace(edit, scale=1.0)))))
    return EditedFrames(frames, edit), edit


def first_points(frames: Frames) -> Gaussians:
    """Return the first frame that holds points.

    Raises:
        GaussiansError: No frame holds points.
    """
    for frame in range(len(frames)):
        if len(points := frames.read(frame)):
            return points
    raise GaussiansError(
        f"{frames.path}: no frame holds a point. Check --crop and --min-opacity, or export the frames again."
    )


def distant_origin(points: Gaussians) -> np.ndarray:
    """Return an origin [3] float64 near the points if float32 stores their positions coarsely, otherwise zeros.

    The origin has as few digits as its distance to the points allows.
    """
    middle = np.median(visible_positions(points), axis=0)
    spacing = float(np.spacing(np.float32(np.abs(middle).max())))
    if spacing <= COARSE * float(np.median(points.scales)):
        return np.zeros(3)
    extent = max(float(np.quantile(np.abs(visible_positions(points) - middle), 0.9)), spacing)
    unit = 10.0 ** np.floor(np.log10(extent))
    return np.round(middle / unit) * unit
