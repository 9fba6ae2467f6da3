"""Light that changes on things that rest: shadows pass over them, lamps go on (beyond the paper).

Flow sees a shadow move, or nothing at all, and both are wrong: what is in its way changes color and stays where it is. All views
that see such a point see it grow darker by the same factor, where of a body that passes before it each view shows another part.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import cv2
import numpy as np
import torch

from splatreel import threads
from splatreel.motion.lift import gathered
from splatreel.motion.splats import SplatTensors
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

MIN_CHANGE = 0.08
"""Logarithm of the factor from which on light counts as changed."""
FRAMES = 2
"""Frames in which it must have changed: noise is gone in the next."""
VIEWS = 3
"""Cameras that must see a point, at least."""
AGREE = 0.6
"""Share of these that must be within `NEAR_BY` of the median, or within `ALIKE` of it times the median itself."""
NEAR_BY, ALIKE = 0.04, 0.35
PIXELS = 1e5
"""Larger pictures are looked at in this size: a shadow is larger than a pixel, and 36 of a 4K camera would fill the memory."""
BLUR = 0.8
"""Pixels that they are smoothed by: less noise, and edges that are not quite where they were are no light."""
SEEN = 0.3
"""Pixels of such a picture that a point must fill to be seen in it."""
DARK = 8.0
"""Gray levels added to all brightness: the noise of what is black is no light."""
MOST = 0.2
"""Share of all points that may be called lit anew: beyond, the strongest are."""


def changes_of_light(
    points: Gaussians, cameras: list[Camera], frames: np.ndarray, near: float, device: torch.device | str = "cpu"
) -> np.ndarray:
    """[T, N] float32, logarithm of the brightness of points that rest, against that at the keyframe; 0 where it is as it was.

    frames: [T, C, H, W, 3] uint8, the keyframe first. Points whose light changes nowhere, or of which the views do not agree, are 0 in
    all frames, and so are those that change as most of a picture does.
    """
    found = np.zeros((len(frames), len(points)), np.float32)
    if len(frames) <= FRAMES or len(points) == 0:
        return found
    shown = _brightness_of(points, cameras, frames, near, device)
    changed = (np.abs(shown) > MIN_CHANGE).sum(2) >= FRAMES  # of NaN, all comparisons are false
    index = np.flatnonzero(changed.sum(0) >= VIEWS)
    light = np.stack([_agreed(shown[:, point]) for point in index], 1) if len(index) else found[:, :0]
    strength = np.where((np.abs(light) > MIN_CHANGE).sum(0) >= FRAMES, np.abs(light).sum(0), 0)
    room = min(int(MOST * len(points)), np.count_nonzero(strength))
    strongest = np.argsort(-strength, kind="stable")[:room]
    found[:, index[strongest]] = light[:, strongest]
    return found


def _brightness_of(
    points: Gaussians, cameras: list[Camera], frames: np.ndarray, near: float, device: torch.device | str
) -> np.ndarray:
    """[C, N, T] how bright each view shows each point, as a logarithm against the keyframe; NaN where it does not see it."""
    splats, shown = (
        SplatTensors.of(points, device),
        np.full((len(cameras), len(points), len(frames)), np.nan, np.float32),
    )
    for row, camera, film in zip(shown, cameras, frames.swapaxes(0, 1), strict=True):
        small = _shrunk(camera)
        with ThreadPoolExecutor(threads.count()) as pool:
            bright = partial(_brightness, width=small.width, height=small.height)
            pictures = np.stack(list(pool.map(bright, film)), 2)
        pictures -= pictures[..., :1].copy()
        pictures -= np.median(pictures[::3, ::3], (0, 1))  # a camera's exposure, or the light of the whole scene
        pictures = np.concatenate([pictures, np.ones_like(pictures[..., :1])], 2)
        sums = gathered(splats, small, torch.from_numpy(pictures).to(device), near).cpu().numpy()
        seen = sums[:, -1] > SEEN
        row[seen] = sums[seen, :-1] / sums[seen, -1:]
    return shown


def _shrunk(camera: Camera) -> Camera:
    """The camera with a picture of at most `PIXELS`."""
    shrink = min(1.0, (PIXELS / (camera.width * camera.height)) ** 0.5)
    return camera.resized(max(1, round(shrink * camera.width)), max(1, round(shrink * camera.height)))


def _brightness(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """[h, w] logarithm of the brightness of a picture [H, W, 3] uint8, at another size."""
    gray = cv2.cvtColor(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
    return np.log(cv2.GaussianBlur(gray.astype(np.float32), (0, 0), BLUR) + DARK)


def _agreed(shown: np.ndarray) -> np.ndarray:
    """[T] what most of the views that see a point, [C, T], show of it; 0 in frames of which they do not agree."""
    seen = shown[~np.isnan(shown[:, 0])]
    middle = np.median(seen, 0)
    alike = np.abs(seen - middle) < np.maximum(NEAR_BY, ALIKE * np.abs(middle))
    return np.where(alike.mean(0) >= AGREE, middle, 0)
