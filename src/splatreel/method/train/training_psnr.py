"""Quality of a trained group on its own images."""

from __future__ import annotations

import numpy as np

from splatreel.method.cameras.time_offsets import TimeOffsets
from splatreel.method.train.dynamic_points import DynamicPoints
from splatreel.method.train.losses import psnr
from splatreel.method.train.render import StaticCache, draw
from splatreel.method.train.training_images import TrainingImages

SAMPLES = 12
"""Training images over which the PSNR of a group is averaged."""


def training_psnr(
    points: DynamicPoints,
    static: StaticCache,
    images: TrainingImages,
    gains: np.ndarray,
    time_offsets: TimeOffsets,
    available: np.ndarray,
) -> float:
    """Return the mean PSNR, dB, over a few training images spread over frames and cameras.

    Args:
        points: Trained points.
        static: Static points.
        images: Training images.
        gains: [C, 3] color gains.
        time_offsets: Learned time offsets.
        available: [T, C] bool, images that exist.
    """
    values = []
    for k in range(SAMPLES):
        frame = k * (images.count - 1) // (SAMPLES - 1)
        cameras = np.flatnonzero(available[frame])
        camera = int(cameras[(k * 7) % len(cameras)])
        view, moment = images.views[camera], time_offsets.moment(frame, camera, images.count)
        image, _ = draw(points.at(moment, view, images.near), view, static.view(camera))
        values.append(psnr(image * gains[camera], images.pixels[frame, camera]))
    return float(np.mean(values))
