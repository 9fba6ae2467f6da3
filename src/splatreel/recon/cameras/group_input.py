"""What all stages of one group look at."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from splatreel import threads
from splatreel.capture.frame_file import frame_array, release_pages
from splatreel.kernels.image import Backdrop, render_image
from splatreel.recon.init.layout import Layout
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.spans import GroupSpan

ENOUGH_SIDE = 768
"""Pixels of the longer side of pictures that are large enough to tell what moves."""


@dataclass(frozen=True)
class GroupInput:
    """The pictures of a group, the cameras that took them, and the scene's measures. No stage changes it.

    span: which frames of the video these are, the overlap with the next group included.
    images: [T, C, H, W, 3] uint8, the keyframe first; what cameras' exposures and the light did has been taken out of them.
    cameras: C, as they stand in this group.
    gains: [C, 3] float32, what a rendered picture is multiplied by to have the colors of each camera.
    time_offsets: [C] float64, frames by which each camera is late, as far as the groups before could tell.
    light: [T, 3] float32, what `Group.light` says; None where the light stays.
    layout: near plane, viewing distance, clearance and background of the scene.
    seed: of the run. device: where to train. antialias: how splats are drawn (`render_image`).
    """

    span: GroupSpan
    images: np.ndarray
    cameras: list[Camera]
    gains: np.ndarray
    time_offsets: np.ndarray
    light: np.ndarray | None
    layout: Layout
    device: torch.device
    seed: int
    antialias: bool

    @property
    def near(self) -> float:
        """Depth before which nothing is trained or drawn, world units."""
        return self.layout.near

    @property
    def unit(self) -> float:
        """Typical viewing distance, world units."""
        return self.layout.unit

    def smaller(self) -> GroupInput:
        """The same with pictures of `ENOUGH_SIDE`, for what needs no more of them: to tell what moves, and about where to.

        Made anew each time, in less than a second: kept, they would take memory while the group trains.
        """
        cameras = [camera.at_most(ENOUGH_SIDE) for camera in self.cameras]
        size = cameras[0].width, cameras[0].height
        if size == (self.cameras[0].width, self.cameras[0].height):
            return self
        images = frame_array((*self.images.shape[:2], size[1], size[0], 3))
        pairs = zip(self.images.reshape(-1, *self.images.shape[2:]), images.reshape(-1, *images.shape[2:]), strict=True)
        with ThreadPoolExecutor(threads.count()) as pool:
            list(pool.map(lambda pair: cv2.resize(pair[0], size, dst=pair[1], interpolation=cv2.INTER_AREA), pairs))
        release_pages(self.images)
        return replace(self, images=images, cameras=cameras)

    def draw(self, points: Gaussians, camera: Camera) -> np.ndarray:
        """[H, W, 3] float32, a picture of points as it comes before the camera's color gain; on the CPU, without gradients."""
        layout = self.layout
        return render_image(points, camera, near=layout.near, antialias=self.antialias, background=layout.background)

    def backdrop(self, points: Gaussians, camera: Camera) -> Backdrop:
        """For pictures as of `draw`, of these and other points."""
        layout = self.layout
        return Backdrop(points, camera, near=layout.near, antialias=self.antialias, background=layout.background)
