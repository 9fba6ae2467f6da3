"""Timings of rendering, training steps and coding on synthetic data of a given size."""

from __future__ import annotations

import numpy as np

from bench.step_timings import step_rows
from bench.timing import Timing, median_ms
from splatreel.codec.group_file import decode_group, encode_group
from splatreel.config import EncodeConfig
from splatreel.kernels.image import render_image
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


def bench_kernels(points: int, width: int, height: int, repeats: int) -> list[Timing]:
    """Measure milliseconds per image of rendering and of training steps of a keyframe and a group."""
    gaussians, camera = cloud(points), front_camera(width, height)
    shape: Timing = {"points": points, "width": width, "height": height}
    rows = [{"what": "render_image", **shape, "ms": median_ms(lambda: render_image(gaussians, camera), repeats)}]
    return [*rows, *step_rows(gaussians, camera, repeats)]


def bench_codec(points: int, frames: int, repeats: int) -> list[Timing]:
    """Measure milliseconds and bytes of encoding and decoding one smoothly moving group with each codec."""
    group = swinging_group(points, frames)
    rows: list[Timing] = []
    for codec in ("predictive", "h265"):
        config = EncodeConfig(codec=codec)
        data, _ = encode_group(group, config)
        shape: Timing = {"codec": codec, "points": points, "frames": frames, "bytes": len(data)}
        encoding = median_ms(lambda config=config: encode_group(group, config), repeats)
        decoding = median_ms(lambda data=data: decode_group(data, "the group"), repeats)
        rows.append({"what": "encode a group", **shape, "ms": encoding})
        rows.append({"what": "decode a group", **shape, "ms": decoding})
    return rows


def cloud(points: int, seed: int = 0) -> Gaussians:
    """Return random small Gaussians in a box in front of `front_camera`. Their colors depend little on the view."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(points, 4))
    sh = rng.normal(0, 0.02, (points, 16, 3))
    sh[:, 0] = rng.normal(0, 0.5, (points, 3))
    return Gaussians(
        means=rng.uniform(-1, 1, (points, 3)) * [1.6, 1.2, 1.0],
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True),
        scales=np.exp(rng.normal(-4.2, 0.5, (points, 3))),
        opacities=rng.uniform(0.1, 1, points),
        sh=sh,
    )


def front_camera(width: int, height: int) -> Camera:
    """Return a camera that looks at the cloud from four units away."""
    viewmat = np.eye(4)
    viewmat[2, 3] = 4
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]])
    return Camera("front", viewmat, K, width, height)


def swinging_group(points: int, frames: int) -> Group:
    """Return a group of the cloud in which every point swings by a tenth of a unit, with a phase from its position."""
    dynamic = cloud(points)
    t = np.arange(frames)[:, None, None] / 30
    dx = 0.1 * np.sin(2 * np.pi * t + 2 * dynamic.means[None])
    dq = np.zeros((frames, points, 4))
    dq[..., 0] = 1
    dq[..., 1] = 0.1 * np.sin(2 * np.pi * t[..., 0] + dynamic.means[None, :, 0])
    return Group(0, 0, dynamic, dx.astype(np.float32), dq.astype(np.float32), np.zeros(0, bool))
