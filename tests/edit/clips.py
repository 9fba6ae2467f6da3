"""Reels for tests of edits, and images of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.codec.opus_sound import encode_sound, write_sound
from splatreel.codec.presentation import Limits
from splatreel.codec.writer import ReelWriter
from splatreel.config import EncodeConfig, Rate
from splatreel.edit.clip_writer import write_clip
from splatreel.edit.operations import apply_operations
from splatreel.edit.reel_clip import ReelClip
from splatreel.play.timeline import Timeline, open_reel
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from tests.flashes import clicks
from tests.golden import camera, random_gaussians, random_motion, random_shade, weights

FPS, LENGTH, OVERLAP = 10, 6, 2
CAMERAS = [camera("cam00", -0.5), camera("cam01", 0.5), camera("cam02", 0.0)]


def write_reel(path: Path, groups: int = 3, renditions: tuple[Rate, ...] = (), seed: int = 4) -> Path:
    """Write a reel of groups of 6 frames with an overlap of 2; layers are born at groups 0 and 1, and the first is retired at 2."""
    rng = np.random.default_rng(seed)
    header = ReelHeader(
        fps=FPS,
        group_length=LENGTH,
        overlap=OVERLAP,
        sh_degree=2,
        bounds=np.array([[-1.5, -1.5, -1.5], [1.5, 1.5, 1.5]]),
        up=np.array([0.0, -1.0, 0.0]),
        camera=camera("start", 0.0),
        cameras=CAMERAS,
        antialias=True,
        near=0.1,
        clearance=Clearance((0.0, 0.0, 0.5), 0.2),
    )
    writer = ReelWriter(path, header, config=EncodeConfig(coarseness=0.5, renditions=renditions))
    sizes: dict[int, int] = {}
    for index in range(groups):
        born = (80, 40)[index] if index < 2 else 0
        if born:
            layer = random_gaussians(rng, born, 2 - index, (0, 0, 0))
            writer.add_layer(index, index * LENGTH, layer, weights(born), until=None if index else 2)
            sizes[index] = born
        if index == 2:
            sizes.pop(0)
        moving = random_gaussians(rng, 40, 1, (0.5, 0.2, 0))
        frames = LENGTH + (OVERLAP if index + 1 < groups else 0)
        dx, dq = random_motion(rng, moving, frames)
        shade = 0.3 * random_shade(rng, len(moving), frames) if index == 1 else None
        times = index * LENGTH + np.arange(frames, dtype=np.float32)[:, None]
        light = 1 - times * np.array([0.01, 0.02, 0.015], np.float32)  # groups agree where they overlap
        alive = rng.random(sum(sizes.values())) > 0.1
        writer.add_group(Group(index, index * LENGTH, moving, dx, dq, alive, shade, light), weights(len(moving)))
    limits = Limits((0.0, 0.0, 0.5), angle=30.0, distance=(1.0, 6.0), floor=-1.0)
    writer.present(replace(writer.manifest.presentation, title="Balls", limits=limits))
    seconds = groups * LENGTH / FPS
    write_sound(writer, encode_sound([clicks((0.3, 0.7, 1.2), seconds)], 1), (1.0, 0.0, 0.0))
    writer.finish()
    return path


def edit(reel: Path, out: Path, *operations: str) -> Timeline:
    """Apply operations, write the result, and open it."""
    write_clip(apply_operations(ReelClip(reel), operations), out)
    return open_reel(out)


def make_image(reel: Timeline, frame: float, camera: Camera | None = None) -> np.ndarray:
    """Render a frame as the player shows it, [60, 80, 3]."""
    view = (reel.manifest.camera if camera is None else camera).resized(80, 60)
    return reel.render(reel.at(frame / reel.fps), view)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Return decibels between two images; at most 99."""
    return min(-10 * np.log10(max(float(np.square(a - b).mean()), 1e-12)), 99.0)


def worst(a: Timeline, b: Timeline, frames: Sequence[tuple[float, float]]) -> float:
    """Return the lowest PSNR of pairs of frames of two reels, each from its own start camera."""
    return min(psnr(make_image(a, one), make_image(b, other)) for one, other in frames)


def all_points(reel: Timeline, frame: float) -> Gaussians:
    """Return what a reel shows at a frame, without what is transparent."""
    shown = reel.at(frame / reel.fps)
    return shown[shown.opacities > 0.02]
