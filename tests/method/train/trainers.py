"""Small trainers of groups and keyframes, for tests of their programs."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.capture.masks import LIKELY
from splatreel.config import Config, preset
from splatreel.config.settings import changed
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.kernels.image import render_image
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.cameras.time_offsets import TimeOffsets
from splatreel.method.deform.knot_adam import Adam
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.group_trainer import GroupTrainer
from splatreel.method.train.keyframe_trainer import KeyframeTrainer, with_gain
from splatreel.method.train.losses import KEYFRAME, Terms
from splatreel.method.train.render import View, deformed, draw
from splatreel.method.train.subject import with_opposite
from splatreel.method.train.trainable_points import TrainablePoints, default_rates, to_params
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import Gaussians, StaticPoints
from tests.method.scenes import ring

NEAR, UNIT, FRAMES = 0.1, 4.0, 5
CAMERAS = ring(4, width=48, height=32)
CLOSE = 1e-4
"""Relative difference of gradients, summed over an iteration with its own rounding."""
SURFACES_CLOSE = 3e-3
"""The same with the losses of surfaces: variances are small differences of large numbers, signs of tiny bends are chance, and unknown
pixels repeat a drawing that is rounded to 8 bits."""


ON_CPU = pytest.param(None, id="CPU")
"""The program of the CPU, which a trainer without a GPU starts."""


class Notes(Silent):
    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


def scattered(count: int, low: list[float], high: list[float], seed: int, bands: int = 4) -> Gaussians:
    """Return oblong points with view-dependent colors."""
    rng = np.random.default_rng(seed)
    quats, sh = rng.normal(size=(count, 4)), rng.normal(0, 0.1, (count, bands, 3))
    sh[:, 0] = rng.uniform(-1, 1.5, (count, 3))
    return Gaussians(
        rng.uniform(low, high, (count, 3)),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        np.exp(rng.normal(-2.0, 0.4, (count, 3))),
        rng.uniform(0.3, 0.9, count),
        sh,
    )


WALL = scattered(300, [-3, -2, 0.9], [3, 2, 1.0], 0)
THING = scattered(70, [-0.8, -0.6, -0.4], [0.2, 0.6, 0.2], 1)


def moved(points: Gaussians, frame: float) -> Gaussians:
    return replace(points, means=(points.means + np.array([0.06 * frame, 0, 0])).astype(np.float32))


def make_images(count: int, antialias: bool = True, background: bool = True, unknown: bool = False) -> TrainingImages:
    scenes = [Gaussians.concatenate([WALL, moved(THING, frame)]) for frame in range(count)]
    images = [[render_image(scene, camera, near=NEAR) for camera in CAMERAS] for scene in scenes]
    pixels = (np.clip(images, 0, 1) * 255).round().astype(np.uint8)
    views = [View.of(camera, antialias) for camera in CAMERAS]
    if background:
        views = [replace(view, background=np.array([0.2, 0.1, 0.3], np.float32)) for view in views]
    mask = None
    if unknown:
        mask = np.zeros(pixels.shape[:4], bool)
        mask[..., 3:9, 5:30] = True
    return TrainingImages(pixels, views, NEAR, UNIT, mask)


def make_subject_images() -> TrainingImages:
    """Return images of a subject before few cameras, over backgrounds of opposite colors whose gains are known.

    Some pixels are in doubt.
    """
    views, pixels, alphas = [], [], []
    for number, camera in enumerate(CAMERAS):
        known = np.array([1.1, 1.0, 0.9] if number % 2 else [0.9, 1.0, 1.1], np.float32)
        view = replace(View.of(camera, True), background=np.array([0.3, 0.6, 0.2], np.float32) / known, gain=known)
        splats, gain = with_gain(
            deformed(to_params(THING), None, None, view, NEAR), view, camera_gains(True).values[number]
        )
        image, alpha = draw(splats, view)
        views.append(view)
        pixels.append((np.clip(image * gain, 0, 1) * 255).round().astype(np.uint8))
        alphas.append((alpha * 255).round().astype(np.uint8))
    opacity = np.array(alphas)[None]
    opacity[..., 3:9, 5:30] = LIKELY
    return with_opposite(TrainingImages(np.array(pixels)[None], views, NEAR, UNIT), opacity)


def camera_gains(enabled: bool) -> CameraGains:
    gains = CameraGains(len(CAMERAS), enabled)
    gains.load(np.array([[0.95, 1.0, 1.02], [1.05, 1.0, 0.98], [0.97, 1.01, 1.0], [1.03, 0.99, 1.0]], np.float32))
    return gains


def group_config(**changes: object) -> Config:
    settings = {
        "group.length": FRAMES,
        "group.overlap": 0,
        "group.iterations_per_frame": 8,
        "group.coarse_share": 0.25,
        "layering.adapt_every": 10,
    }
    return changed(preset("standard"), settings | changes)


def group_trainer(
    gpu: SharedGpu | None,
    config: Config | None = None,
    static: Gaussians = WALL,
    images: TrainingImages | None = None,
    losses: Terms | None = None,
) -> GroupTrainer:
    rng = np.random.default_rng(3)
    paths = np.stack([moved(THING, frame).means for frame in range(FRAMES)])
    tracks = (paths + rng.normal(0, 0.01, paths.shape)).astype(np.float32)
    offsets = TimeOffsets(len(CAMERAS))
    offsets.load(np.array([0.1, -0.2, 0.15, -0.05]))
    return GroupTrainer(
        images or make_images(FRAMES),
        GroupStart(THING, tracks),
        StaticPoints(static, np.ones(len(static), bool)),
        config or group_config(),
        gains=camera_gains(False),
        time_offsets=offsets,
        gpu=gpu,
        losses=losses,
    )


def keyframe_trainer(
    gpu: SharedGpu | None, losses: Terms = KEYFRAME, static: Gaussians | None = None, **changes: object
) -> KeyframeTrainer:
    start = THING if static is not None else Gaussians.concatenate([WALL, THING])
    noise = np.random.default_rng(4).normal(0, 0.02, start.means.shape)
    start = replace(start, means=(start.means + noise).astype(np.float32))
    points = TrainablePoints.from_gaussians(start, default_rates(UNIT, 4.0))
    config = changed(preset("standard"), {"keyframe.densify_every": 10, **changes}).keyframe
    return KeyframeTrainer(points, camera_gains(True), config, static=static, max_points=600, losses=losses, gpu=gpu)


def difference(found: Adam, expected: Adam) -> float:
    """Return the relative difference of the first moments: of the gradients so far."""
    assert found.parameter.shape == expected.parameter.shape
    assert found.steps == expected.steps
    size = float(np.linalg.norm(expected.mean))
    return float(np.linalg.norm(found.mean - expected.mean)) / (size if size > 1e-9 else 1.0)


def group_adams(trainer: GroupTrainer) -> dict[str, Adam]:
    points = trainer.points
    assert points.appearance is not None
    nodes, motion = points.deformation.adams  # type: ignore[union-attr]
    return points.canonical.adams | {"nodes": nodes, "motion": motion, "appearance": points.appearance.adam}
