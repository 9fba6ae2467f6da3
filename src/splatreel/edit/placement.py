"""Rotation, scale and shift of a whole clip, with its cameras, limits and sound."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.predictive.precision import Precision
from splatreel.codec.presentation import Limits, Vec3
from splatreel.edit.clip import ChangedClip, Clip, ClipGroup, ClipLayer, ClipSound, Outline
from splatreel.scene import rotations
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import Gaussians, turned


@dataclass(frozen=True)
class Similarity:
    """Map of positions x to scale * (quat x) + shift.

    Attributes:
        quat: Rotation, [4] wxyz, unit.
        scale: Factor of lengths.
        shift: [3], world units.
        turns_up: The up direction turns with the points. Otherwise it stays, and the scene turns relative to it.
    """

    quat: np.ndarray = field(default_factory=lambda: np.array([1.0, 0, 0, 0]))
    scale: float = 1.0
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    turns_up: bool = False

    @property
    def matrix(self) -> np.ndarray:
        """Rotation matrix, [3, 3]."""
        return rotations.to_matrix(np.asarray(self.quat, np.float64))

    @property
    def turns(self) -> bool:
        """True if the map rotates."""
        return abs(float(self.quat[0])) < 1

    def position(self, points: np.ndarray) -> np.ndarray:
        """Return positions [..., 3] after the map."""
        return self.scale * np.asarray(points, np.float64) @ self.matrix.T + self.shift

    def points(self, points: Gaussians) -> Gaussians:
        """Return Gaussians after the map, with their view-dependent colors."""
        moved = turned(points, self.quat) if self.turns else points
        means = self.position(points.means)
        return replace(moved, means=means, scales=points.scales * self.scale)

    def precision(self, precision: Precision | None) -> Precision | None:
        """Return the precision of points after the map. Without a rotation, the grid of positions moves along."""
        if precision is None:
            return None
        low = None if self.turns or precision.low is None else self.position(precision.low)
        steps = {name: step * (self.scale if name == "dx" else 1.0) for name, step in precision.steps.items()}
        moved = replace(precision, low=low, cell=precision.cell * self.scale, steps=steps)
        return moved.with_mixed_channels() if self.turns else moved

    def camera(self, camera: Camera) -> Camera:
        """Return a camera that sees the moved points as `camera` sees the points."""
        viewmat = camera.viewmat.astype(np.float64)
        viewmat[:3, :3] = viewmat[:3, :3] @ self.matrix.T
        viewmat[:3, 3] = self.scale * viewmat[:3, 3] - viewmat[:3, :3] @ self.shift
        return replace(camera, viewmat=viewmat)

    def up(self, header: ReelHeader) -> np.ndarray:
        """Return the up direction after the map, [3]."""
        return self.matrix @ header.up if self.turns_up else header.up

    def header(self, header: ReelHeader) -> ReelHeader:
        """Return the header after the map."""
        corners = self.position(np.array(list(itertools.product(*header.bounds.T))))
        focus = _vector(self.position(np.array(header.clearance.focus)))
        return replace(
            header,
            bounds=np.stack([corners.min(0), corners.max(0)]),
            up=self.up(header),
            camera=self.camera(header.camera),
            cameras=tuple(map(self.camera, header.cameras)),
            near=header.near * self.scale,
            clearance=Clearance(focus, header.clearance.share),
            origin=self.scale * self.matrix @ header.origin,
        )

    def limits(self, limits: Limits | None, header: ReelHeader) -> Limits | None:
        """Return the limits after the map. `header` is that before it."""
        if limits is None:
            return None
        focus, floor, distance = np.array(limits.focus), limits.floor, limits.distance
        if floor is not None:
            below = focus + (floor - focus @ header.up) * header.up
            floor = float(self.position(below) @ self.up(header))
        if distance is not None:
            distance = distance[0] * self.scale, distance[1] * self.scale
        return replace(limits, focus=_vector(self.position(focus)), floor=floor, distance=distance)

    def outline(self, outline: Outline) -> Outline:
        """Return the facts of the moved clip."""
        return replace(
            outline,
            header=self.header(outline.header),
            limits=self.limits(outline.limits, outline.header),
            sound=self._sound(outline.sound),
        )

    def _sound(self, sound: ClipSound | None) -> ClipSound | None:
        if sound is None or sound.position is None:
            return sound
        return replace(sound, position=_vector(self.position(np.array(sound.position))))


class Moved(ChangedClip):
    """Clip after a similarity."""

    def __init__(self, clip: Clip, similarity: Similarity) -> None:
        super().__init__(clip, similarity.outline(clip.outline))
        self._similarity = similarity

    def change_layer(self, index: int, layer: ClipLayer) -> ClipLayer:
        """Return a layer after the map."""
        return ClipLayer(self._similarity.points(layer.points), self._similarity.precision(layer.precision))

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group after the map."""
        map_ = self._similarity
        dx = map_.scale * found.group.dx @ map_.matrix.T.astype(np.float32)
        group = replace(found.group, dynamic=map_.points(found.group.dynamic), dx=dx.astype(np.float32))
        return replace(found, group=group, precision=map_.precision(found.precision))


def _vector(position: np.ndarray) -> Vec3:
    x, y, z = (round(float(value), 9) for value in position)
    return x, y, z
