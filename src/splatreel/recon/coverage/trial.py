"""What new views will be like, tried: a camera that is trained on is left out of a quick and small reconstruction.

Training views tell nothing of that: with cameras far apart they are as good as ever, and what is between them is fog. Only a camera
that was left out tells, and whoever trains on all of them never looks at one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from splatreel.config import preset
from splatreel.kernels.image import render_image
from splatreel.progress import Progress
from splatreel.recon.train.single_frame import reconstruct_single_frame
from splatreel.scene.camera import Camera, angles_apart, middle_camera

WIDTH = 192
"""Pixels across its pictures, at most."""
OTHERS = 8
"""Cameras that it trains on: the nearest to the one that is left out, which are those that show what it does."""
ITERATIONS, POINTS = 400, 8000
MARGIN = 1.0
"""dB by which it must be better than what can be had without any reconstruction."""
BEST = 99.0
"""dB of pictures that are the same."""
GAINS = 0.5, 2.0
"""By what a color may be multiplied for a picture to fit: cameras' exposures differ."""


@dataclass(frozen=True)
class Trial:
    """camera: which was left out. angle: degrees from there to the nearest of the others, seen from the focus.

    psnr: dB of its picture as reconstructed from the others. flat: of one color all over, the mean. nearest: of the nearest camera's
    picture in place of it.
    """

    camera: str
    angle: float
    psnr: float
    flat: float
    nearest: float

    @property
    def holds(self) -> bool:
        """Whether the view is worth more than no reconstruction at all."""
        return self.psnr > max(self.flat, self.nearest) + MARGIN


def leave_one_out(
    cameras: list[Camera],
    images: np.ndarray,
    focus: np.ndarray,
    points: np.ndarray | None,
    colors: np.ndarray | None,
    near: float | None,
    device: torch.device,
    progress: Progress,
) -> Trial:
    """Leave the middle camera out. images: [C, H, W, 3] uint8, of one moment. focus: [3], what the cameras look at.

    points [P, 3], colors [P, 3] 0..1 and near are the capture's, see `initial_points`. Takes some seconds, whatever the capture's size.
    """
    left, angles = middle_camera(cameras, focus), angles_apart(cameras, focus)
    others = np.argsort(angles[left], kind="stable")[: min(OTHERS, len(cameras) - 1)].tolist()
    small = [smaller(camera, WIDTH) for camera in cameras]
    shown = {c: shrunk(images[c], small[c]) for c in [left, *others]}
    config = preset("draft")
    keyframe = replace(config.keyframe, first_iterations=ITERATIONS, max_points=POINTS, densify_every=50)
    config = replace(config, keyframe=keyframe)
    progress.stage(f"trying what new views will be like, without {cameras[left].name}", ITERATIONS)
    gaussians, layout = reconstruct_single_frame(
        [small[c] for c in others],
        np.stack([shown[c] for c in others]),
        config,
        points=points,
        point_colors=colors,
        near=near,
        device=device,
        progress=_Quiet(progress),
    )
    drawn = render_image(
        gaussians, small[left], near=layout.near, antialias=config.antialias, background=layout.background
    )
    truth = shown[left].astype(np.float64) / 255
    flat = np.broadcast_to(truth.mean((0, 1)), truth.shape)
    return Trial(
        cameras[left].name,
        round(float(angles[left].min()), 2),
        _psnr(np.clip(drawn, 0, 1), truth),
        _psnr(flat, truth),
        _psnr(shown[others[0]].astype(np.float64) / 255, truth),
    )


def smaller(camera: Camera, width: int) -> Camera:
    """A camera of at most that width."""
    if camera.width <= width:
        return camera
    return camera.resized(width, max(round(camera.height * width / camera.width), 1))


def shrunk(image: np.ndarray, camera: Camera) -> np.ndarray:
    """An image [H, W, 3] uint8 of the size of a camera."""
    size = camera.width, camera.height
    return image if image.shape[1::-1] == size else cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _psnr(picture: np.ndarray, truth: np.ndarray) -> float:
    """dB between pictures [H, W, 3] 0..1, once the one has been given the other's exposure."""
    gain = (picture * truth).sum((0, 1)) / np.maximum((picture * picture).sum((0, 1)), 1e-9)
    error = np.square(picture * np.clip(gain, *GAINS) - truth).mean()
    return round(min(float(-10 * np.log10(max(error, 1e-12))), BEST), 2)


class _Quiet:
    """Steps, but no words: what is said of a scene with a camera less is not said of the scene."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def stage(self, name: str, total: int, span: tuple[float, float] | None = None) -> None: ...

    def update(self, done: int, **numbers: float) -> None:
        self._progress.update(done)

    def note(self, text: str) -> None: ...
