"""Evidence that pixels show the subject: differences from the background, colors, and the agreement of the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from splatreel.scene.camera import Camera, focus_point
from splatreel.segmentation.background import SATURATED, Background, largest_channel

LIMIT = 3.0
"""Largest evidence of a pixel, as log odds."""
UNSURE = 3.0
"""Difference from the background, in standard deviations, at which a pixel is as likely of the subject as of the background."""
MIN_FLOOR, MAX_FLOOR = 2.0, 5.0
"""Smallest and largest standard deviation of small changes of light, gray levels. It adds to the noise."""
MEASURED = 6
"""Number of samples in which changes of light are measured."""
HUE_FLOOR = 2.0
"""The same for differences that are left after the brightness is fitted, gray levels."""
DARKEST_SHADOW = 0.5
"""Smallest brightness of a shadow, as a share of the background's."""
SHADOW_ODDS = -0.75
"""Evidence of a pixel that looks like the background in a shadow. Other cameras overrule it where they see a body."""
SHADOW_EDGE = 3.0
"""Change of brightness between neighboring pixels of a soft shadow, gray levels. It adds to the noise."""
DIMMED = 0.9
"""Factor of light below which a saturated background has no known color."""
BLUR = 0.7
"""Standard deviation of the filter that reduces noise before images are compared, pixels."""


def subject_evidence(frame: np.ndarray, background: Background) -> np.ndarray:
    """Return log odds [H, W] float32 that pixels show the subject, -LIMIT..LIMIT. They are 0 where the background is unknown.

    Args:
        frame: [H, W, 3] uint8.
        background: Background of the camera.
    """
    seen, behind = _compared(frame, background)
    difference = largest_channel(np.abs(seen - behind)) / np.hypot(background.noise, background.floor)
    found = np.clip(difference / UNSURE - 1, -1, 1) * LIMIT
    shadow = _shadow_likeness(seen, behind, np.hypot(background.noise, HUE_FLOOR))
    found = np.where(found > SHADOW_ODDS, found + (SHADOW_ODDS - found) * shadow, found)
    # A background that is too bright for the camera has no known color in less light.
    bright = largest_channel(background.image)
    unknown = ~background.known | ((bright >= SATURATED) & (largest_channel(behind) < DIMMED * bright))
    return np.where(unknown, 0, found).astype(np.float32)


def difference(frame: np.ndarray, background: Background) -> np.ndarray:
    """Return the difference [H, W] float32 of a frame [H, W, 3] uint8 from the background, gray levels.

    It is infinite where the background is unknown.
    """
    seen, behind = _compared(frame, background)
    return np.where(background.known, largest_channel(np.abs(seen - behind)), np.float32(np.inf))


def with_floor(background: Background, samples: np.ndarray) -> Background:
    """Return the background with the changes of light that samples [S, H, W, 3] uint8 show where nothing moves.

    In a studio these changes are small, so that a shirt is told from a wall of almost the same color.
    """
    chosen = np.unique(np.linspace(0, len(samples) - 1, MEASURED).round().astype(int))
    differences = np.stack([difference(samples[number], background) for number in chosen])
    still = differences[differences < UNSURE * np.hypot(background.noise, MAX_FLOOR)]
    deviation = np.percentile(still, 90) / 1.645 if still.size else MAX_FLOOR
    return replace(background, floor=float(np.clip(deviation, MIN_FLOOR, MAX_FLOOR)))


def _compared(frame: np.ndarray, background: Background) -> tuple[np.ndarray, np.ndarray]:
    """Return a frame and the background in its light, [H, W, 3] float32 each, with less noise."""
    seen = cv2.GaussianBlur(frame.astype(np.float32), (0, 0), BLUR)
    return seen, cv2.GaussianBlur(background.lit(frame), (0, 0), BLUR)


def _shadow_likeness(seen: np.ndarray, behind: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return [H, W], 0..1, how well a darker background explains the pixels: the same hue and the same structure.

    Within a shadow, the ratio to the background changes slowly. On cloth and at borders of bodies it changes quickly.
    """
    ratio = (seen * behind).sum(-1) / np.maximum((behind * behind).sum(-1), 1)
    hue = largest_channel(np.abs(seen - ratio[..., None] * behind)) / noise
    likely = np.clip(2 - hue / UNSURE, 0, 1) * (ratio > DARKEST_SHADOW) * (ratio < 1)
    texture = cv2.morphologyEx(ratio, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) * behind.mean(-1)
    texture = texture / np.hypot(noise, SHADOW_EDGE)
    return likely * np.clip(2 - texture / UNSURE, 0, 1)


BINS = 24
"""Number of bins of each axis: gray level, red minus green, blue minus the mean of red and green."""
CHROMA = 42.0
"""Largest difference of channels with bins of its own, gray levels."""
PRIOR = 2e-4
"""Share of pixels that is added to each bin."""
COLOR_LIMIT = 2.0
"""Largest evidence of a color, as log odds."""


class ColorModel:
    """Histograms of the colors of the subject and of its surroundings, which grow by `add`.

    Args:
        counts: [2, BINS, BINS, BINS] float32, pixels of the subject and of its surroundings; by default none.
    """

    def __init__(self, counts: np.ndarray | None = None) -> None:
        self.counts = np.zeros((2, BINS, BINS, BINS), np.float32) if counts is None else counts

    @classmethod
    def merged(cls, models: Sequence[ColorModel]) -> ColorModel:
        """Return the colors in all of several cameras, which count alike."""
        totals = [np.maximum(model.counts.sum((1, 2, 3), keepdims=True), 1) for model in models]
        return cls(np.sum([model.counts / total for model, total in zip(models, totals, strict=True)], axis=0))

    def add(self, image: np.ndarray, subject: np.ndarray, surroundings: np.ndarray) -> None:
        """Count the pixels of an image [H, W, 3] uint8 that certainly show the subject or its surroundings, [H, W] bool each."""
        bins = _bins(image)
        for counts, pixels in zip(self.counts, (subject, surroundings), strict=True):
            counts += np.bincount(bins[pixels], minlength=BINS**3).reshape(counts.shape)

    def evidence(self, image: np.ndarray) -> np.ndarray:
        """Return log odds [H, W] float32 of the subject by the colors of an image [H, W, 3] uint8."""
        if not self.counts.any((1, 2, 3)).all():
            return np.zeros(image.shape[:2], np.float32)
        smooth = [_smoothed(counts / counts.sum()) for counts in self.counts]
        odds = np.log(smooth[0] + PRIOR) - np.log(smooth[1] + PRIOR)
        return np.clip(odds, -COLOR_LIMIT, COLOR_LIMIT).ravel()[_bins(image)]


def _bins(image: np.ndarray) -> np.ndarray:
    r, g, b = np.moveaxis(cv2.GaussianBlur(image, (0, 0), 0.8).astype(np.float32), -1, 0)
    axes = ((r + g + b) / 3 / 256, (r - g + CHROMA) / (2 * CHROMA), (b - (r + g) / 2 + CHROMA) / (2 * CHROMA))
    gray, first, second = (np.clip(axis * BINS, 0, BINS - 1).astype(np.int64) for axis in axes)
    return (gray * BINS + first) * BINS + second


def _smoothed(counts: np.ndarray) -> np.ndarray:
    for axis in range(3):
        padded = np.pad(counts, [(1, 1) if a == axis else (0, 0) for a in range(3)], mode="edge")
        parts = [np.take(padded, np.arange(k, k + BINS), axis) for k in range(3)]
        counts = 0.25 * parts[0] + 0.5 * parts[1] + 0.25 * parts[2]
    return counts


CELLS = 64
"""Number of coarse cells along each side of the searched cube."""
FINE = 3
"""Number of fine cells along a side of a coarse cell."""
AGAINST = 2.0
"""Weight of a view that shows background at a place, relative to a view that shows the subject there."""
MIN_OTHERS = 2
"""Number of other cameras that must see a place before their evidence counts."""


class Agreement:
    """Cube around the place that the cameras look at, from which the subject is carved.

    Args:
        cameras: C cameras, at the size of the evidence.
        near: Smallest depth, world units.
    """

    def __init__(self, cameras: list[Camera], near: float = 0.0) -> None:
        self.cameras = cameras
        self.near = max(near, 1e-6)
        low, self.size = _cube(cameras)
        steps = (np.arange(CELLS, dtype=np.float32) + 0.5) * self.size
        places = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3) + low
        views = np.sum([self._project(places, camera)[0] >= 0 for camera in cameras], 0)
        self._coarse = places[views > min(MIN_OTHERS, len(cameras) - 1)]
        self._projected = [self._project(self._coarse, camera) for camera in cameras]
        offsets = np.stack(np.meshgrid(*[np.arange(FINE)] * 3, indexing="ij"), -1).reshape(-1, 3)
        self._offsets = (((offsets + 0.5) / FINE - 0.5) * self.size).astype(np.float32)

    def support(self, evidence: np.ndarray) -> np.ndarray:
        """Return what the other cameras say about each pixel, [C, H, W] float32, in the unit of the evidence.

        The value of a pixel is the largest mean of the other cameras' evidence over the places on its ray. It is very negative
        where no place is supported.

        Args:
            evidence: [C, H, W] float32, log odds.
        """
        places = (self._occupied(evidence)[:, None] + self._offsets).reshape(-1, 3)
        projected = [self._project(places, camera) for camera in self.cameras]
        values = np.stack([_look_up(view, pixels) for (pixels, _), view in zip(projected, evidence, strict=True)])
        seen, total = np.sum([pixels >= 0 for pixels, _ in projected], 0), values.sum(0)
        out = np.full(evidence.shape, -AGAINST * LIMIT, np.float32)
        for c, (pixels, depth) in enumerate(projected):
            others = seen - 1  # for the places that this camera sees
            use = (pixels >= 0) & (others >= min(MIN_OTHERS, len(self.cameras) - 1))
            mean = (total - values[c])[use] / others[use]
            self._splat(out[c], pixels[use], depth[use], mean, self.cameras[c])
        return out

    def _project(self, places: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Return the index of each place's pixel, -1 outside of the image, and the depth of each place."""
        viewmat, K = camera.viewmat.astype(np.float32), camera.K.astype(np.float32)
        seen = places @ viewmat[:3, :3].T + viewmat[:3, 3]
        depth = seen[:, 2]
        ahead = depth > self.near
        pixels = (seen @ K.T)[:, :2] / np.where(ahead, depth, 1)[:, None]
        inside = ahead & ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(1)
        column, row = np.where(inside[:, None], pixels, 0).astype(np.int32).T
        return np.where(inside, row * camera.width + column, -1), depth

    def _occupied(self, evidence: np.ndarray) -> np.ndarray:
        """Return the centers of coarse cells that may hold the subject, [N, 3]."""
        total = np.zeros(len(self._coarse), np.float32)
        for camera, (pixels, depth), view in zip(self.cameras, self._projected, evidence, strict=True):
            if (pixels >= 0).any():
                reach = 0.75 * self.size * camera.K[0, 0] / float(np.median(depth[pixels >= 0]))
                total += _look_up(cv2.dilate(view, _square(reach)), pixels)
        return self._coarse[total > 0]

    def _splat(
        self, out: np.ndarray, pixels: np.ndarray, depth: np.ndarray, values: np.ndarray, camera: Camera
    ) -> None:
        """Write the largest of the values into each pixel of an image. A cell covers as many pixels as it appears wide."""
        if len(pixels) == 0:
            return
        order = np.argsort(values, kind="stable")
        flat = out.ravel()
        flat[pixels[order]] = values[order]  # of equal indices, the last and largest remains
        reach = 0.5 * self.size / FINE * camera.K[0, 0] / float(np.percentile(depth, 10))
        out[:] = cv2.dilate(flat.reshape(out.shape), _square(reach))


def _square(reach: float) -> np.ndarray:
    return np.ones((2 * int(np.ceil(reach)) + 1,) * 2, np.uint8)


def _look_up(view: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the evidence at pixels, 0 outside of the image. Evidence of the background weighs more."""
    value = np.where(pixels >= 0, view.ravel()[np.maximum(pixels, 0)], 0)
    return np.where(value < 0, AGAINST * value, value)


def _cube(cameras: list[Camera]) -> tuple[np.ndarray, float]:
    """Return the lower corner of the cube, [3] float32, and the size of a coarse cell."""
    middle = focus_point(cameras)
    distances = np.linalg.norm(np.stack([camera.center for camera in cameras]) - middle, axis=1)
    reach = float(np.percentile(distances, 90))
    return (middle - reach).astype(np.float32), 2 * reach / CELLS
