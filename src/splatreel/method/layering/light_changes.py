"""Changes of light on static content, such as shadows and lamps (beyond the paper).

Flow sees a shadow move, or nothing at all; in truth the content changes color and stays in place. All views that see a point
see it darken by the same factor. Of a body that passes in front of it, each view shows another part.
"""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.method.layering.lift import gather_images
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

MIN_CHANGE = 0.08
"""Minimum change of light, as a logarithm of brightness."""
MIN_FRAMES = 2
"""Minimum number of frames with a change. Noise is gone in the next frame."""
MIN_VIEWS = 3
"""Minimum number of cameras that must see a point."""
MIN_AGREEING_SHARE = 0.6
"""Share of these cameras that must be within `ABSOLUTE_TOLERANCE` of the median, or within `RELATIVE_TOLERANCE` times the median."""
ABSOLUTE_TOLERANCE, RELATIVE_TOLERANCE = 0.04, 0.35
MAX_PIXELS = 1e5
"""Larger images are shrunk to this size. Shadows are larger than a pixel, and 36 images of a 4K camera would fill the memory."""
BLUR = 0.8
"""Standard deviation of the blur, pixels, against noise and misaligned edges."""
MIN_SEEN_PIXELS = 0.3
"""Minimum number of pixels of such an image that a point must fill to be seen."""
BLOCK = 4096
"""Points whose views are compared at a time."""
DARK_OFFSET = 8.0
"""Gray levels added to all brightness, so that noise of dark pixels is not a change of light."""
MAX_CHANGED_SHARE = 0.2
"""Maximum share of points that change light; if there are more, the strongest changes count."""


def changes_of_light(points: Gaussians, cameras: list[Camera], frames: np.ndarray, near: float) -> np.ndarray:
    """Return the logarithm [T, N] float32 of the brightness of static points, relative to the keyframe; 0 for no change.

    Points are 0 in all frames if the views disagree, or if they change like most of an image.

    Args:
        points: N points.
        cameras: All cameras.
        frames: [T, C, H, W, 3] uint8, the keyframe first.
        near: Near plane, world units.
    """
    found = np.zeros((len(frames), len(points)), np.float32)
    if len(frames) <= MIN_FRAMES or len(points) == 0:
        return found
    shown = _brightness_of(points, cameras, frames, near)
    changed = (np.abs(shown) > MIN_CHANGE).sum(2) >= MIN_FRAMES  # unseen points are NaN, which compares false
    index = np.flatnonzero(changed.sum(0) >= MIN_VIEWS)
    parts = (shown[:, index[start : start + BLOCK]] for start in range(0, len(index), BLOCK))
    light = np.concatenate([found[:, :0], *map(_common_changes, parts)], 1)
    strength = np.where((np.abs(light) > MIN_CHANGE).sum(0) >= MIN_FRAMES, np.abs(light).sum(0), 0)
    room = min(int(MAX_CHANGED_SHARE * len(points)), np.count_nonzero(strength))
    strongest = np.argsort(-strength, kind="stable")[:room]
    found[:, index[strongest]] = light[:, strongest]
    return found


def _brightness_of(points: Gaussians, cameras: list[Camera], frames: np.ndarray, near: float) -> np.ndarray:
    """Return the log brightness [C, N, T] of each point in each view, relative to the keyframe; NaN where not seen."""
    shown = np.full((len(cameras), len(points), len(frames)), np.nan, np.float32)
    for row, camera, film in zip(shown, cameras, frames.swapaxes(0, 1), strict=True):
        small = _shrunk(camera)
        bright = partial(_brightness, width=small.width, height=small.height)
        images = np.stack(threads.map_parallel(bright, film), 2)
        images -= images[..., :1].copy()
        images -= np.median(images[::3, ::3], (0, 1))  # remove exposure and light of the whole scene
        images = np.concatenate([images, np.ones_like(images[..., :1])], 2)
        sums = gather_images(points, small, images, near)
        seen = sums[:, -1] > MIN_SEEN_PIXELS
        row[seen] = sums[seen, :-1] / sums[seen, -1:]
    return shown


def _shrunk(camera: Camera) -> Camera:
    """Return the camera with an image of at most `MAX_PIXELS`."""
    shrink = min(1.0, (MAX_PIXELS / (camera.width * camera.height)) ** 0.5)
    return camera.resized(max(1, round(shrink * camera.width)), max(1, round(shrink * camera.height)))


def _brightness(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the log brightness [h, w] of an image [H, W, 3] uint8 at another size."""
    gray = cv2.cvtColor(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
    return np.log(cv2.GaussianBlur(gray.astype(np.float32), (0, 0), BLUR) + DARK_OFFSET)


def _common_changes(shown: np.ndarray) -> np.ndarray:
    """Return the changes [T, N] on which most of the views [C, N, T] agree; 0 in frames without agreement.

    Views that do not see a point are NaN in all frames. Every point is seen by a view.
    """
    count = (~np.isnan(shown[:, :, :1])).sum(0, keepdims=True)
    ordered = np.sort(shown, 0)  # NaN comes last
    low, high = (np.take_along_axis(ordered, place, 0)[0] for place in ((count - 1) // 2, count // 2))
    middle = (low + high) / 2
    alike = np.abs(shown - middle) < np.maximum(ABSOLUTE_TOLERANCE, RELATIVE_TOLERANCE * np.abs(middle))
    return np.where(alike.sum(0) / count[0] >= MIN_AGREEING_SHARE, middle, 0).T
