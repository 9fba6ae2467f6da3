"""Check of poses by the masks of a subject: the mask of each camera must fit the visual hull of the others.

Large masks fit at any poses. So the same is asked of poses that are wrong: masks confirm poses only if they would not fit then.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatreel.capture.base import MIN_CAMERAS
from splatreel.capture.masks import LIKELY
from splatreel.method.init.visual_hull import VisualHull
from splatreel.scene.camera import Camera

RAYS, STEPS = 200, 64
"""Number of pixels of each mask that are examined, and of places on the ray of each."""
SMALLEST = 0.1
"""Smallest size of a mask, as a share of the median. With a wrong pose, masks without weights keep only a small part that fits."""
NEAREST, FARTHEST = 0.1, 1.9
"""Ends of the rays, as shares of the camera's distance from the focus."""
TURN = 7.0
"""Degrees by which a camera is turned to get a wrong pose."""
CLEAR = 0.1
"""Smallest difference between the share of a mask that fits and the one that fits at a wrong pose
(docs/experiments/2026-11-28-poses-confirmed-by-masks.md)."""
NEARER, BETTER = 0.2, 0.01
"""Share of its distance by which a camera is moved towards the focus and away from it, and by how much more of the masks then fits
on average if its pose is wrong. Masks hardly fit less if it is right."""


@dataclass(frozen=True)
class _WrongPoses:
    """Poses that are not the given ones.

    Attributes:
        text: The end of a sentence that says what is wrong.
        changed: Numbers of the cameras whose poses differ.
        cameras: C cameras.
        order: For each camera, the number of its masks.
    """

    text: str
    changed: list[int]
    cameras: list[Camera]
    order: list[int]


class Silhouettes:
    """Masks of a subject, whose fit to each other is measured at the given poses and at wrong ones.

    Args:
        cameras: C cameras.
        masks: [M, C, H, W] uint8, opacity of the subject at M moments.
        focus: [3] world, middle of the scene.
        near: Smallest depth, world units.
    """

    def __init__(self, cameras: Sequence[Camera], masks: np.ndarray, focus: np.ndarray, near: float) -> None:
        self._cameras = list(cameras)
        self._focus, self._near = focus, near
        sizes = (masks >= LIKELY).sum((2, 3))
        self._usable = sizes > SMALLEST * np.median(sizes, 1, keepdims=True)
        self._hulls = [VisualHull(self._cameras, moment, near) for moment in masks]
        self._pixels = [[_chosen_pixels(mask) for mask in moment] for moment in masks]
        given = list(range(len(self._cameras)))
        self._given = [self._fits(self._cameras, given, c) for c in given]

    @property
    def fits(self) -> list[float]:
        """Share of each camera's mask, 0..1, whose pixels show a place within the hull of the other masks, on average of the moments.

        With right poses it is 1 but for errors of the masks. One pose that is wrong by ten degrees has 0.4 to 0.8 in the worst camera.
        A mask smaller than `SMALLEST` of the median confirms nothing and has 0. So has each of fewer than three: two masks fit for
        most poses.
        """
        if len(self._cameras) < MIN_CAMERAS:
            return [0.0] * len(self._cameras)
        return [float(np.nanmean(fit)) if not np.isnan(fit).all() else 0.0 for fit in self._given]

    def wrong_poses_that_fit(self) -> str:
        """Return poses that fit the masks as well as the given ones, as the end of a sentence; an empty text if there are none."""
        for wrong in self._wrong_poses():
            others = [c for c in range(len(self._cameras)) if c not in wrong.changed]
            if not any(self._is_worse(wrong, c) for c in [*wrong.changed, *others]):
                return f"as well if {wrong.text}"
        return next((f"better if {moved.text}" for moved in self._moved() if self._is_better(moved)), "")

    def _is_better(self, moved: _WrongPoses) -> bool:
        """Return True if more of the masks fits at other poses."""
        fits = [self._fits(moved.cameras, moved.order, c) for c in moved.order]
        return bool(np.nanmean(fits) > np.nanmean(self._given) + BETTER)

    def _is_worse(self, wrong: _WrongPoses, c: int) -> bool:
        """Return True if the mask of a camera fits clearly less at wrong poses, at one moment."""
        drops = self._given[c] - self._fits(wrong.cameras, wrong.order, c)
        return bool((drops >= CLEAR).any())

    def _wrong_poses(self) -> Iterator[_WrongPoses]:
        given = list(range(len(self._cameras)))
        for c, camera in enumerate(self._cameras):
            for yaw, pitch in ((TURN, 0), (-TURN, 0), (0, TURN), (0, -TURN)):
                cameras = [*self._cameras[:c], _turned(camera, yaw, pitch), *self._cameras[c + 1 :]]
                yield _WrongPoses(f"{camera.name} were turned by {TURN:.0f} degrees", [c], cameras, given)
        for c, camera in enumerate(self._cameras):
            for other in range(c):
                order = given.copy()
                order[c], order[other] = other, c
                names = f"{self._cameras[other].name} and {camera.name}"
                yield _WrongPoses(f"{names} were exchanged", [c, other], self._cameras, order)

    def _moved(self) -> Iterator[_WrongPoses]:
        """Yield poses at which one camera is nearer to the focus, or farther away."""
        for c, camera in enumerate(self._cameras):
            depth = camera.viewmat[2, :3] @ self._focus + camera.viewmat[2, 3]
            for share, word in ((NEARER, "farther away"), (-NEARER, "nearer")):
                viewmat = camera.viewmat.copy()
                viewmat[2, 3] += share * depth
                cameras = [*self._cameras[:c], replace(camera, viewmat=viewmat), *self._cameras[c + 1 :]]
                yield _WrongPoses(f"{camera.name} were {NEARER:.0%} {word}", [c], cameras, list(range(len(cameras))))

    def _fits(self, cameras: list[Camera], order: list[int], c: int) -> np.ndarray:
        """Return the share [M] of a camera's mask that fits the others at each moment, NaN where it is small."""
        found = np.full(len(self._hulls), np.nan)
        others = [other for other in range(len(cameras)) if other != c]
        for moment, hull in enumerate(self._hulls):
            if self._usable[moment, order[c]]:
                places = self._places(cameras[c], self._pixels[moment][order[c]])
                inside = hull.of([cameras[k] for k in others], [order[k] for k in others]).contains(places)
                found[moment] = inside.any(1).mean()
        return found

    def _places(self, camera: Camera, pixels: np.ndarray) -> np.ndarray:
        """Return places [R, STEPS, 3] on the rays of pixels [R, 3]."""
        directions = pixels @ np.linalg.inv(camera.K).T @ camera.viewmat[:3, :3]
        distance = float(np.linalg.norm(camera.center - self._focus))
        depths = np.linspace(max(self._near, NEAREST * distance), FARTHEST * distance, STEPS)
        return camera.center + directions[:, None] * depths[:, None]


def _chosen_pixels(mask: np.ndarray) -> np.ndarray:
    """Return the middles [R, 3] of pixels of a mask [H, W] uint8, homogeneous."""
    rows, columns = np.nonzero(mask >= LIKELY)
    chosen = np.linspace(0, len(rows) - 1, min(RAYS, len(rows))).round().astype(int)
    return np.stack([columns[chosen] + 0.5, rows[chosen] + 0.5, np.ones(len(chosen))], -1)


def _turned(camera: Camera, yaw: float, pitch: float) -> Camera:
    """Return a camera that is turned by degrees around its vertical and its horizontal axis."""
    a, b = np.radians(yaw), np.radians(pitch)
    turn = np.eye(4)
    turn[:3, :3] = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]) @ np.array(
        [[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]]
    )
    return replace(camera, viewmat=turn @ camera.viewmat)
