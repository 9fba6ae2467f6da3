"""Trial that predicts the quality of novel views: a quick, small reconstruction without one training camera.

Training views do not predict it. With cameras far apart they look good, while novel views between them are fog. Only a
camera that was left out tells, and training on all cameras leaves none out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from splatreel.base.progress import Progress
from splatreel.capture.color import over_color
from splatreel.capture.masks import PALETTE, is_doubtful
from splatreel.config import preset
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.kernels.image import render_image
from splatreel.method.train.single_frame import Subject, reconstruct_single_frame
from splatreel.scene.camera import Camera, angles_apart, middle_camera

TRIAL_WIDTH = 192
"""Largest width in pixels of the images."""
OTHERS = 8
"""Number of cameras that are trained on: the nearest to the one that is left out, which show the same things."""
ITERATIONS, POINTS = 400, 8000
BEHIND = 0, 0, 0
"""Color behind the subject where images are compared. Within soft edges the room would count as the subject's error."""
MARGIN = 1.0
"""Decibels by which the reconstruction must be better than an image without any reconstruction."""
BEST = 99.0
"""Decibels of identical images."""
GAINS = 0.5, 2.0
"""Range of the factor on a color by which an image is fitted, since the exposures of cameras differ."""


@dataclass(frozen=True)
class Trial:
    """Result of a trial.

    Attributes:
        angle: Degrees between this camera and the nearest other one, seen from the focus.
        psnr: PSNR in dB of its image as reconstructed from the others. That of a subject is within its mask, over black, and without
            a fit to the exposure, as `evaluate` measures it.
        flat: PSNR in dB of one flat color, the mean of the image.
        nearest: PSNR in dB of the nearest camera's image in its place.
    """

    camera: str
    angle: float
    psnr: float
    flat: float
    nearest: float

    @property
    def holds(self) -> bool:
        """True if the reconstruction is better than no reconstruction at all."""
        return self.psnr > max(self.flat, self.nearest) + MARGIN


def leave_one_out(
    cameras: list[Camera],
    images: np.ndarray,
    focus: np.ndarray,
    points: np.ndarray | None,
    colors: np.ndarray | None,
    near: float | None,
    progress: Progress,
    alpha: np.ndarray | None = None,
    gpu: SharedGpu | None = None,
) -> Trial:
    """Leave the middle camera out of a small reconstruction. It takes some seconds, whatever the size of the capture.

    `focus` [3] is the place that the cameras look at, `alpha` [C, H, W] the opacity of the subject; None is the whole
    scene.
    """
    left, angles = middle_camera(cameras, focus), angles_apart(cameras, focus)
    others = np.argsort(angles[left], kind="stable")[: min(OTHERS, len(cameras) - 1)].tolist()
    small = [narrow_camera(camera, TRIAL_WIDTH) for camera in cameras]
    shown = {c: resize_image(images[c], small[c]) for c in [left, *others]}
    config = preset("draft")
    keyframe = replace(config.keyframe, first_iterations=ITERATIONS, max_points=POINTS, densify_every=50)
    config = replace(config, keyframe=keyframe)
    progress.stage(f"quick trial without {cameras[left].name} (predicts novel-view quality)", ITERATIONS)
    masks = None if alpha is None else {c: resize_image(alpha[c], small[c]) for c in [left, *others]}
    images, subject = (
        (np.stack([shown[c] for c in others]), None)
        if masks is None
        else _subject(others, [small[c].name for c in others], shown, masks)
    )
    gaussians, layout = reconstruct_single_frame(
        [small[c] for c in others],
        images,
        config,
        points=points,
        point_colors=colors,
        near=near,
        subject=subject,
        gpu=gpu,
        progress=_StepsOnly(progress),
    )
    drawn = render_image(
        gaussians, small[left], near=layout.near, antialias=config.antialias, background=layout.background
    )
    compared = {c: shown[c] if masks is None else over_color(shown[c], masks[c], BEHIND) for c in (left, others[0])}
    truth, nearest = (compared[c].astype(np.float64) / 255 for c in (left, others[0]))
    within = np.ones(truth.shape[:2], bool) if masks is None else (masks[left] > 0) & ~is_doubtful(masks[left])
    if not within.any():  # the camera does not show the subject
        within[:] = True
    flat = np.broadcast_to(truth[within].mean(0), truth.shape)
    found = (_psnr(image[within], truth[within], masks is None) for image in (np.clip(drawn, 0, 1), flat, nearest))
    return Trial(cameras[left].name, round(float(angles[left].min()), 2), *found)


def _subject(
    chosen: list[int], names: list[str], shown: dict[int, np.ndarray], masks: dict[int, np.ndarray]
) -> tuple[np.ndarray, Subject]:
    """Return the images of a subject over the colors of the palette, and the subject."""
    colors = [PALETTE[place % len(PALETTE)] for place in range(len(chosen))]
    images = [
        over_color(shown[c], masks[c], (255 * np.array(color)).astype(np.uint8))
        for c, color in zip(chosen, colors, strict=True)
    ]
    alpha = np.stack([masks[c] for c in chosen])
    return np.stack(images), Subject(alpha, dict(zip(names, colors, strict=True)))


def narrow_camera(camera: Camera, width: int) -> Camera:
    """Return a camera resized to at most that width."""
    if camera.width <= width:
        return camera
    return camera.resized(width, max(round(camera.height * width / camera.width), 1))


def resize_image(image: np.ndarray, camera: Camera) -> np.ndarray:
    """Return an image [H, W, 3] uint8 resized to the size of a camera."""
    size = camera.width, camera.height
    return image if image.shape[1::-1] == size else cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _psnr(image: np.ndarray, truth: np.ndarray, fitted: bool) -> float:
    """Return the PSNR in dB of pixels [P, 3] 0..1. `fitted` fits them to the exposure of the true image first."""
    if fitted:
        image = image * np.clip((image * truth).sum(0) / np.maximum((image * image).sum(0), 1e-9), *GAINS)
    error = np.square(image - truth).mean()
    return round(min(float(-10 * np.log10(max(error, 1e-12))), BEST), 2)


class _StepsOnly:
    """Progress that shows steps, but no texts: findings about the scene without one camera do not hold for the whole scene."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def stage(self, name: str, total: int, span: tuple[float, float] | None = None) -> None: ...

    def update(self, done: int, **numbers: float) -> None:
        self._progress.update(done)

    def note(self, text: str) -> None: ...
