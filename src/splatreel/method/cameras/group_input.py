"""Images and cameras of one group, which all of its stages read."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.base.paged_arrays import frame_array, release_pages
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.kernels.image import Backdrop, render_image
from splatreel.method.cameras.rig import Rig
from splatreel.method.init.bodies import subject_hull
from splatreel.method.init.layout import Layout
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import GroupSpan
from splatreel.scene.volumes import Volume

ENOUGH_SIDE = 768
"""Pixels of the longer side of images that are large enough to find out what moves."""


@dataclass(frozen=True)
class GroupInput:
    """Images of a group, the cameras that took them, and the measures of the scene.

    Attributes:
        images: Images [T, C, H, W, 3] uint8, the keyframe first. Changes of exposures and light are removed from them.
        light: Factors [T, 3] float32 as in `Group.light`; None where the light does not change.
        missing: [T, C] bool, images that the cameras lack and that images of nearby frames stand in for; None if all exist.
            They are not trained on.
        plates: Images [C, H, W, 3] uint8 of the scene that all chapters share, which the exposures of a chapter are measured
            against; None outside of chapters.
        alpha: [T, C, H, W] uint8, opacity of a subject before few cameras; None for all others.
    """

    span: GroupSpan
    images: np.ndarray
    rig: Rig
    light: np.ndarray | None
    layout: Layout
    seed: int
    antialias: bool
    missing: np.ndarray | None = None
    plates: np.ndarray | None = None
    gpu: SharedGpu | None = None
    alpha: np.ndarray | None = None

    @property
    def cameras(self) -> list[Camera]:
        """Cameras [C] with the poses that they have in this group."""
        return self.rig.cameras

    def find_hull(self) -> Volume | None:
        """Return the volume that the keyframe's points must be in; None is everywhere. This takes seconds with networks of people."""
        return None if self.alpha is None else subject_hull(self.cameras, self.images[0], self.alpha[0], self.near)

    @property
    def gains(self) -> np.ndarray:
        """Color gains [C, 3] float32: factors from a rendered image to the colors of each camera."""
        return self.rig.gains

    @property
    def time_offsets(self) -> np.ndarray:
        """Frames [C] float64 by which each camera is late, as far as earlier groups could tell."""
        return self.rig.time_offsets

    @property
    def unknown(self) -> np.ndarray | None:
        """Pixels [C, H, W] bool of the keyframe without a valid value: those of cameras that lack it; None if all are valid."""
        if self.missing is None or not self.missing[0].any():
            return None
        return np.broadcast_to(self.missing[0][:, None, None], self.images.shape[1:4]).copy()

    @property
    def near(self) -> float:
        """Depth of the near plane in world units. Nothing nearer is trained or drawn."""
        return self.layout.near

    @property
    def unit(self) -> float:
        """Typical viewing distance in world units."""
        return self.layout.unit

    def smaller(self) -> GroupInput:
        """Return the same input with images of at most `ENOUGH_SIDE`, for stages that need no larger ones.

        The images are computed again at each call, in less than a second. Kept, they would take memory while the group trains.
        """
        cameras = [camera.at_most(ENOUGH_SIDE) for camera in self.cameras]
        size = cameras[0].width, cameras[0].height
        if size == (self.cameras[0].width, self.cameras[0].height):
            return self
        images = frame_array((*self.images.shape[:2], size[1], size[0], 3))
        pairs = zip(self.images.reshape(-1, *self.images.shape[2:]), images.reshape(-1, *images.shape[2:]), strict=True)
        threads.map_parallel(lambda pair: cv2.resize(pair[0], size, dst=pair[1], interpolation=cv2.INTER_AREA), pairs)
        release_pages(self.images)
        return replace(self, images=images, rig=replace(self.rig, cameras=cameras))

    def draw(self, points: Gaussians, camera: Camera) -> np.ndarray:
        """Return an image [H, W, 3] float32 of points, before the camera's color gain. It is drawn on the CPU, without gradients."""
        background = self.background_of(camera)
        return render_image(points, camera, near=self.near, antialias=self.antialias, background=background)

    def backdrop(self, points: Gaussians, camera: Camera) -> Backdrop:
        """Return a backdrop of points, which other points can be drawn in front of."""
        background = self.background_of(camera)
        return Backdrop(points, camera, near=self.near, antialias=self.antialias, background=background)

    def background_of(self, camera: Camera) -> tuple[float, float, float]:
        """Return the color behind all points in an image before the camera's color gain, 0..1."""
        return self.layout.background_of(camera, self.gains[self.rig.names.index(camera.name)])
