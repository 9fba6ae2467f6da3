"""Background of a static camera: the color that each pixel repeats most exactly, and its noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np

MIN_NOISE, MAX_NOISE = 1.5, 10.0
"""Smallest and largest standard deviation of a pixel, gray levels. Compression hides smaller noise. More is motion."""
EDGE_NOISE = 0.25
"""Noise for each gray level of local contrast. Wind and compression shake edges by a fraction of a pixel."""
BANDWIDTH = 3.0
"""Width of the search for the most frequent color, in standard deviations of the camera's noise."""
CANDIDATES = 12
"""Number of samples whose colors are tried as the most frequent one."""
MIN_SAMPLES = 3
"""Number of samples that must show a pixel's background, or it is unknown. Fewer samples than six need half of them."""
LIGHT_REACH = 0.12
"""Distance within which light changes alike, as a share of the image width."""
LIGHT_RANGE = 0.35
"""Largest change of light, as a logarithm. More is a body."""
SHRINK, FEWEST_BLOCKS = 8, 24
"""Width of the blocks that changes of light are measured in, pixels, and their smallest number along the width of small images."""
SWITCHED, SWITCHED_SHARE = 0.15, 0.15
"""Smallest logarithm of a change of light that is more than drift, and the smallest share of the image that it changes."""
LARGEST_SWITCH, LIGHT_STEP = 1.6, 0.1
"""Largest logarithm of a change of light, and the difference between those that are tried."""
DARK, SATURATED = 4.0, 250
"""Gray levels between which a pixel tells the light."""


@dataclass(frozen=True)
class Background:
    """Background of a camera.

    Attributes:
        image: [H, W, 3] float32, gray levels 0..255.
        noise: [H, W] float32, standard deviation, gray levels.
        share: [H, W] float32, share 0..1 of the samples that show the background.
        known: [H, W] bool, pixels whose background was seen.
        floor: Standard deviation of small changes of light, gray levels. It adds to the noise.
    """

    image: np.ndarray
    noise: np.ndarray
    share: np.ndarray
    known: np.ndarray
    floor: float = 5.0

    def lit(self, frame: np.ndarray) -> np.ndarray:
        """Return the background [H, W, 3] float32 in the light and exposure of a frame [H, W, 3] uint8."""
        return np.minimum(self.image * _light_change(frame, self.image, self.known), 255)

    def without(self, doubtful: np.ndarray) -> Background:
        """Return the background with the pixels of `doubtful` [H, W] bool unknown."""
        return replace(self, known=self.known & ~doubtful)


def fit_background(samples: np.ndarray, certainty: np.ndarray | None = None) -> Background:
    """Find the background in samples of a video.

    The background repeats its color to within the noise, while a person who stands still repeats it less exactly. So the
    background is the densest color, even in pixels that a person covers most of the time.

    Args:
        samples: [S, H, W, 3] uint8.
        certainty: [S, H, W] float32, 0..1, how certain a sample shows the background; by default all are alike. Samples of 0 count for
            nothing.
    """
    film = samples.astype(np.float32)
    certainty = np.ones(film.shape[:3], np.float32) if certainty is None else certainty.astype(np.float32)
    spread = _typical_noise(film)
    distances = np.arange(256, dtype=np.float32) / (BANDWIDTH * spread)
    likeness = np.maximum(1 - distances * distances, 0)  # of each difference of gray levels
    best, image = np.full(film.shape[1:3], -1, np.float32), film[0].copy()
    for number in np.unique(np.linspace(0, len(film) - 1, CANDIDATES).round().astype(int)):
        density = np.zeros_like(best)
        for sample, weight in zip(samples, certainty, strict=True):
            density += weight * cv2.LUT(largest_channel(cv2.absdiff(sample, samples[number])), likeness)
        density = cv2.GaussianBlur(density, (3, 3), 0)
        better = density > best
        best[better], image[better] = density[better], film[number][better]
    image, noise = _refined(film, certainty, image, BANDWIDTH * spread)
    near = (largest_channel(np.abs(film - image)) < BANDWIDTH * spread) & (certainty > 0)
    known = near.sum(0) >= min(MIN_SAMPLES, 0.5 * len(film))
    contrast = cv2.morphologyEx(image.mean(-1), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    return Background(image, np.hypot(noise, EDGE_NOISE * contrast), near.mean(0, dtype=np.float32), known)


def largest_channel(images: np.ndarray) -> np.ndarray:
    """Return the largest channel [..., H, W] of images [..., H, W, 3], several times as fast as `max(-1)`."""
    return np.maximum(np.maximum(images[..., 0], images[..., 1]), images[..., 2])


def _refined(film: np.ndarray, certainty: np.ndarray, image: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean and the standard deviation of the samples around a color, after three steps of mean shift."""
    noise = np.zeros(image.shape[:2], np.float32)
    for _ in range(3):
        mean, square, total = np.zeros_like(image), np.zeros_like(noise), np.full_like(noise, 1e-3)
        for sample, weight in zip(film, certainty, strict=True):
            difference = sample - image
            near = weight * (largest_channel(np.abs(difference)) < reach)
            mean += near[..., None] * difference
            square += near * np.square(difference.mean(-1))
            total += near
        image, noise = image + mean / total[..., None], np.sqrt(square / total)
    return image, np.clip(noise, MIN_NOISE, MAX_NOISE)


def _typical_noise(film: np.ndarray) -> float:
    """Return the standard deviation of the camera's noise, gray levels, from differences of consecutive samples."""
    if len(film) < 2:
        return 2 * MIN_NOISE
    middles = [np.median(np.abs(b - a)) for a, b in pairwise(film)]
    return float(np.clip(1.05 * np.median(middles), 2 * MIN_NOISE, MAX_NOISE))


def same_light(film: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Return samples [S, H, W, 3] uint8 in one light, and how certain their pixels are, [S, H, W] float32.

    The light is that of a sample that is like most others and not too bright for the camera. Where all samples have about the
    same light, they stay as they are, and the second value is None.
    """
    brightness = np.stack([_log_light(sample)[0] for sample in film])
    apart = np.array([[np.median(np.abs(one - other)) for other in brightness] for one in brightness])
    saturated = (largest_channel(film) >= SATURATED).mean((1, 2))  # they do not tell how they look in less light
    typical = int((apart.mean(1) + saturated).argmin())
    changed = (np.abs(brightness - brightness[typical]) > SWITCHED).mean((1, 2)) > SWITCHED_SHARE
    if not changed.any():
        return film, None
    out, certainty = film.copy(), np.ones(film.shape[:3], np.float32)
    everywhere = np.ones(film.shape[1:3], bool)
    for number in np.flatnonzero(changed):
        change = _light_change(film[number], film[typical].astype(np.float32), everywhere)
        out[number] = np.clip(np.rint(film[number] / change), 0, 255)
        certainty[number] = film[number].max(-1) < SATURATED
    return out, certainty


def _log_light(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the logarithms of the brightness [h, w] and of the colors [h, w, 3] of an image's blocks."""
    height, width = image.shape[:2]
    block = max(min(SHRINK, width // FEWEST_BLOCKS), 1)
    small = max(width // block, 1), max(height // block, 1)
    colors = np.maximum(cv2.resize(image.astype(np.float32), small, interpolation=cv2.INTER_AREA), DARK)
    return np.log(colors.mean(-1)), np.log(colors)


def _light_change(frame: np.ndarray, background: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the smooth factor, [H, W, 3] or [1, 1, 1] float32, between the background and a frame of the same surfaces."""
    height, width = known.shape
    (seen, seen_colors), (behind, behind_colors) = _log_light(frame), _log_light(background)
    ratio = seen_colors - behind_colors
    small = ratio.shape[1::-1]
    usable = cv2.resize(known.astype(np.float32), small, interpolation=cv2.INTER_AREA)
    usable = usable * (seen_colors.max(-1) < np.log(SATURATED)) * (behind_colors.max(-1) < np.log(SATURATED))
    start = _light_levels(seen - behind, usable)[..., None]
    usable = usable * (np.abs(ratio - start).max(-1) < LIGHT_RANGE)
    if usable.sum() < 0.05 * usable.size:
        return np.full((1, 1, 1), _factor_of_saturated(np.exp(seen_colors), np.exp(behind_colors)), np.float32)
    rest = ratio - start
    common = np.array([_weighted_median(rest[..., k].ravel(), usable.ravel()) for k in range(3)], np.float32)
    change = np.broadcast_to(start + common, ratio.shape)
    for _ in range(2):
        near = (usable * np.exp(-np.square(np.abs(ratio - change).max(-1) / 0.05))).astype(np.float32)
        weight = cv2.GaussianBlur(near, (0, 0), LIGHT_REACH * small[0])
        shift = cv2.GaussianBlur((rest - common) * near[..., None], (0, 0), LIGHT_REACH * small[0])
        change = start + common + shift / (weight + 0.1)[..., None]
    return np.exp(cv2.resize(change.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR))


def _factor_of_saturated(seen: np.ndarray, behind: np.ndarray) -> float:
    """Return the factor between the colors [h, w, 3] of blocks, most of them too bright for the camera; 1 if none explains them."""
    factors = np.exp(np.arange(-LARGEST_SWITCH, LARGEST_SWITCH, LIGHT_STEP / 2))
    errors = np.array([np.median(np.abs(np.minimum(behind * factor, 255) - seen)) for factor in [1.0, *factors]])
    return float(factors[errors[1:].argmin()]) if errors[1:].min() < 0.5 * errors[0] else 1.0


def _light_levels(level: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return the large changes of light of blocks [h, w] as logarithms, 0 where light is about the same.

    A lamp that is switched changes large parts of an image by one factor, in which a body has many. So each block takes the factor that
    is frequent around it and in the whole image.

    Args:
        level: [h, w] logarithm of the ratio of brightness.
        usable: [h, w] weights of the blocks.
    """
    large = usable * (np.abs(level) >= SWITCHED)
    if large.sum() < SWITCHED_SHARE * usable.sum():
        return np.zeros_like(level)
    factors = np.arange(-LARGEST_SWITCH, LARGEST_SWITCH + 0.01, LIGHT_STEP, dtype=np.float32)
    votes = usable * np.exp(-np.square((level - factors[:, None, None]) / LIGHT_STEP))
    overall = votes.sum((1, 2)) / max(usable.sum(), 1e-6)
    reach = LIGHT_REACH * level.shape[1]
    around = cv2.GaussianBlur(usable.astype(np.float32), (0, 0), reach) + 1e-3
    score = np.stack([cv2.GaussianBlur(vote.astype(np.float32), (0, 0), reach) / around for vote in votes])
    score *= (overall + 0.05)[:, None, None]
    score[np.abs(factors) < SWITCHED] *= 1.5
    return factors[score.argmax(0)]


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(sums, sums[-1] / 2)])
