"""A subject over two opposite backgrounds, so that no point can pass for a background.

Each camera has one color behind its subject. A point that only this camera sees, beside the subject, can take that color, and is
then a halo in novel views. Over the color and its opposite in turn, only transparency is right.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatreel.base.paged_arrays import frame_array
from splatreel.capture.masks import is_doubtful
from splatreel.method.train.render import View
from splatreel.method.train.training_images import TrainingImages


def with_opposite(images: TrainingImages, alpha: np.ndarray) -> TrainingImages:
    """Return training images of a subject together with the same images over the opposite backgrounds.

    Args:
        images: Images of a subject. Their views have the backgrounds.
        alpha: [T, C, H, W] uint8, opacity of the subject. Pixels in doubt become unknown.
    """
    if (unknown := is_doubtful(alpha)).any():
        images = replace(images, unknown=unknown if images.unknown is None else unknown | images.unknown)
    pixels, views = images.pixels, [opposite_view(view) for view in images.views]
    changes = [_change(view) for view in images.views]
    other = frame_array(pixels.shape)
    for frame, opacity in enumerate(alpha):
        for camera, change in enumerate(changes):
            behind = 1 - opacity[camera] / np.float32(255)
            color = pixels[frame, camera] + behind[..., None] * change
            other[frame, camera] = color.round().clip(0, 255)
    return replace(images, opposite=replace(images, pixels=other, views=views, array=other))


def opposite_view(view: View) -> View:
    """Return a view with the opposite color behind all points."""
    gain = np.ones(3, np.float32) if view.gain is None else view.gain
    return replace(view, background=(1 - _behind(view)) / gain)


def _behind(view: View) -> np.ndarray:
    """Return the color [3] behind the subject in the images of a view, 0..1."""
    if view.background is None:
        return np.zeros(3, np.float32)
    return view.background if view.gain is None else view.background * view.gain


def _change(view: View) -> np.ndarray:
    """Return the difference [3] of the opposite background and the background of a view, 0..255."""
    return 255 * (1 - 2 * _behind(view))
