"""What all stages of one group look at."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from splatreel.kernels.image import render_image
from splatreel.recon.init.layout import Layout
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.spans import GroupSpan


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

    def at_most(self, side: int) -> GroupInput:
        """The same with pictures halved, width and height, as long as one of them is longer than this; pixels."""
        width, height, halvings = self.cameras[0].width, self.cameras[0].height, 0
        while max(width, height) >> halvings > side:
            halvings += 1
        if not halvings:
            return self
        size = max(width >> halvings, 1), max(height >> halvings, 1)
        images = np.empty((*self.images.shape[:2], size[1], size[0], 3), np.uint8)
        for place, image in zip(
            images.reshape(-1, *images.shape[2:]), self.images.reshape(-1, height, width, 3), strict=True
        ):
            cv2.resize(image, size, dst=place, interpolation=cv2.INTER_AREA)
        return replace(self, images=images, cameras=[camera.resized(*size) for camera in self.cameras])

    def draw(self, points: Gaussians, camera: Camera) -> np.ndarray:
        """[H, W, 3] float32, a picture of points as it comes before the camera's color gain; on the CPU, without gradients."""
        layout = self.layout
        return render_image(points, camera, near=layout.near, antialias=self.antialias, background=layout.background)
